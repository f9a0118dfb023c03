"""The simulated car with its actuators and its sensor, anybody's plant, and its faults.

It imports `scenario` and `firmware_model`; the nodes run it.
"""
