"""What can run as the controller, by the names that a command gives it; imports nothing heavy."""

from typing import Final

CONTROLLERS: Final = ("python", "c", "ecu", "arm:m4f", "arm:m7")
SERIAL: Final = "arm:serial:"  # and the device of a port
