"""Is channel 1 lost? Adaptive threshold, model of the loss, torque probe, and the way over to F̂.

Imports `filters`, `status`, `structs` and `precision`; the controller and the layout import it.
"""
