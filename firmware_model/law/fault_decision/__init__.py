"""Is channel 1 lost? Other cars, sequential test, model of the loss, transfer to F̂.

Imports `filters`, `status`, `structs`, `precision` and `exponential`; the controller and the layout
import this package.
"""
