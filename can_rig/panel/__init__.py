"""A live view of a run, in a browser on this machine.

It listens on the bus as any other node, and what it sends is what ``can-rig inject`` sends. The
server knows nothing of control, the page nothing of CAN. May import every room but ``cli``.
"""
