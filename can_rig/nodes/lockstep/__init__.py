"""Nodes in lockstep: virtual time stands still until the other node has answered.

A tick is five frames in a fixed order: reference and feedback from the plant node (with a drive,
the speed precedes both), then the commands and the status from the controller node. The feedback
starts the controller's tick, the status ends the plant's tick. A command missing at the arrival of
the status was therefore dropped, and no node waits for a dropped command.
"""
