"""What a run leaves behind: every frame in `bus.log`, and what the plant reports beside it.

Imported by `nodes` and `results`; it imports `logs` and what lies below.
"""
