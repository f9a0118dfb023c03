"""The inputs of a drive: speed over time, the driver's reference, columns of a CSV.

Imports `settings`, `tables` and `build`; `reference`, plant and nodes import it.
"""
