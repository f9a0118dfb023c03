"""Records to frames and back through the DBC, with end-to-end protection.

It imports `errors` only; `scenario` and every room above it may import it.
"""
