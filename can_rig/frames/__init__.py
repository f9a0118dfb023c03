"""Records to frames and back through the DBC, with end-to-end protection.

It imports nothing of `can_rig` but `errors`.
"""
