"""A python-can bus by name: the local bus, SocketCAN, and every other bus of python-can.

It imports `errors` only; `nodes` and every room above may import it.
"""
