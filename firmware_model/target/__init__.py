"""What runs on the target and nothing else: the control law and the layout of its memory.

Imports nothing of `firmware_model` but `compiled`; everything that runs the law imports it.
"""
