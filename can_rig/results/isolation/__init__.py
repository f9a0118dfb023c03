"""Whose fault it was, from what was on the bus: verdict and evidence by tick, and in words.

Imported by `results`, its `report` and the closing lines of a run.
"""
