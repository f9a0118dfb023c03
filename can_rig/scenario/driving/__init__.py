"""What a car is driven along: its speed over time, what its driver asks for, columns of a CSV.

Imports `settings`, `tables` and `build`; `reference`, plant and nodes import it.
"""
