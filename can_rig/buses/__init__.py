"""A python-can bus by name: the local bus, SocketCAN, and every other bus of python-can.

It imports only `errors`; `nodes` and all rooms above may import `buses`.
"""
