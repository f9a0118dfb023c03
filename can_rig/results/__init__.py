"""A run folder: signals, metrics, the report, and the same run without its fault.

It imports `plant`, `scenario`, `logs` and `frames`; `replay`, `views` and `cli` use it.
"""
