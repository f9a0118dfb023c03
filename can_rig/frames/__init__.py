"""Records to frames and back through the DBC, with end-to-end protection.

It imports only `errors` and `firmware_model`; `scenario` and all rooms above may import `frames`.
"""
