"""The thesis's law: C, F1 with 1 + Q, F̂, what the actuators can do, and the reference shaper.

``thesis`` reads like chapter 3 and runs alone. Imports only `structs`, `precision` and `status`.
"""
