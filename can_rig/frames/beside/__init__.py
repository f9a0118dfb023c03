"""Frames that are on every network of the rig beside its own: scenarios compared, runs touched."""
