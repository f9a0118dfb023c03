"""How far a run in lockstep can be touched while it goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Interaction:
    """How far a run can be touched."""

    injectable: bool = False
    """Whether ``RIG_CONTROL`` is obeyed; otherwise it is counted and refused."""
    pace: float = 0.0
    """Times real time that lockstep is held to; 0: as fast as it can."""
    replayed: bool = False
    """Whether the commands are those of a log, so that nobody waits between them."""


UNTOUCHED: Final = Interaction()
