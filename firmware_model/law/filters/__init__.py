"""The filters of the law: biquads, C, F1 with 1 + Q, and F̂, each with its constants and state.

Imports only `structs` and `precision` of `target`.
"""
