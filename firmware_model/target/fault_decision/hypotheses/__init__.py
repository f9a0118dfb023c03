"""Whose fault is it? What else than a lost torque explains d̂, and how well each does.

Imports the rest of the decision but ``decision`` itself, which calls ``verdict`` in every tick.
"""
