"""Whose fault is it? The explanations of d̂ besides a lost torque, and their evidence.

Imports all modules of the decision except ``decision``; ``decision`` calls ``verdict`` in every
tick.
"""
