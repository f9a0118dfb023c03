"""The control law as C99: the lines of `firmware_model.target`, translated, compiled, and run.

Imported by `cli` and `nodes`; the package imports `scenario` and lower rooms.
"""
