"""What runs on the target and nothing else: the control law and the layout of its memory.

It imports nothing of `firmware_model` but `compiled`; everything that controls anything imports it.
"""
