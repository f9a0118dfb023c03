"""Checks before a run: stability, margins, tuning, bus timing.

Only `cli`, `thesis` and `results` import `assessment`; the room imports `scenario` and lower rooms.
"""
