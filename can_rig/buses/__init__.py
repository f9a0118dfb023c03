"""A python-can bus by name: the local bus, SocketCAN, and whatever python-can knows.

It imports nothing of `can_rig` but `errors`.
"""
