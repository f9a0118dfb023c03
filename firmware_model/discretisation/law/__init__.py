"""The filters of the control law together: the plant's factors in z, the loops within a tick.

For `tables`, which fills the constant table from them.
"""
