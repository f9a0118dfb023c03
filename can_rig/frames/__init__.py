"""Records to frames and back through the DBC, end-to-end protection, the latest arrival of frames.

It imports only `errors` and `firmware_model`; `scenario` and all rooms above may import `frames`.
"""
