"""The car is slower than the lowest design: the controller stands by.

A torque hardly moves D* of a slow car, and no model holds there. Both commands go to zero in a
straight line; the decision waits, and a known fault stays known. The tick that leaves is a begin
with saved knowledge (``knowledge``), and takes over a car that was turned by its driver
(``takeover``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct

if TYPE_CHECKING:
    from firmware_model.law.layout import Table


class State(Struct):
    """State."""

    slow: Annotated[int, "1", "1: the car is slower than the lowest design"]
    elapsed: Annotated[float, "tick", "ticks in standby"]


@firmware
def stands_by(table: Table, own: State, complete: bool) -> bool:
    """Whether the controller stands by; ``complete``: a tick with both inputs."""
    waits: bool = not complete or own.elapsed < table.prediction.longest
    return own.slow > 0 or (own.elapsed > 0.0 and waits)


@firmware
def ticks_left_in_standby(table: Table, own: State) -> float:
    """The ticks left on the way to zero, of a tick in standby."""
    left: float = table.prediction.longest - own.elapsed
    own.elapsed += real(1.0, left)
    return left
