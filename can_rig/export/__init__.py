"""The control law as C99: the lines of `firmware_model.law`, translated, compiled, and run.

`source` reads a module, `subset` gives everything a type and refuses the rest, `effects` refuses
what C would compute in another order, `c_functions` and `c_files` write C; `law` and `application`
are the files of an export, `controllers` run them. `trials`, `costs` and `findings` are evidence.
Imported by `cli` and `nodes`; the package imports `scenario` and lower rooms.
"""

from typing import Final

CONTROLLERS: Final = ("python", "c", "ecu", "arm:m4f", "arm:m7")
"""The controllers of a run, by their names on the command line."""

SERIAL: Final = "arm:serial:"
"""A controller on a board: this, and the device of a port."""
