"""The filters of the control law together: the plant's factors in z, the loops within a tick.

`tables` fills the constant table from these filters.
"""
