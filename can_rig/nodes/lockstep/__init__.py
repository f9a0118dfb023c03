"""Nodes in lockstep: virtual time stands still until the other node has answered.

A tick is five frames in one order: reference and feedback from the plant node, before them the
speed of a car that has a drive, then the commands and the status from the controller node. The
feedback starts the controller's tick, the status ends
the plant's, so a command that is not there when the status comes was dropped, and nobody waits.
"""
