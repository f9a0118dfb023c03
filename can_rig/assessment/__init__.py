"""Checks before a run: stability, margins, tuning, bus timing.

Rooms above import `assessment`; the room imports `plant` and lower rooms.
"""
