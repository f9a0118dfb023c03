"""A live view of a run, in a browser on this machine.

The panel listens on the bus like any other node, and sends the same frames as ``can-rig inject``.
The server knows nothing of control, the page nothing of CAN. May import every room but ``cli``.
"""
