"""The code of the target: the control law and the layout of its memory.

Imports only `compiled` of `firmware_model`; every caller of the law imports this package.
"""
