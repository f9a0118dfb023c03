"""The controllers that a run can have, and the protocol that a controller fulfils.

`protocol` says what a node asks of a controller. `our_law` is the control law in Python or as C
(`compiled_law`), `ecus` are whole controller nodes in C, and `making` finds a controller by its
name. `nodes` imports the protocol alone: a controller is passed in.
"""

from typing import Final

CONTROLLERS: Final = ("python", "c", "ecu", "arm:m4f", "arm:m7")
"""The ways to run the control law, by their names on the command line."""

SERIAL: Final = "arm:serial:"
"""A controller on a board: this, and the device of a port."""
