"""Checks before a run: stability, margins, tuning.

Rooms above import `assessment`; the room imports `plant` and lower rooms.
"""
