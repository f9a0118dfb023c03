"""The controllers of a run, by their names on the command line.

The module has no heavy imports.
"""

from typing import Final

CONTROLLERS: Final = ("python", "c", "ecu", "arm:m4f", "arm:m7")
SERIAL: Final = "arm:serial:"  # and the device of a port
