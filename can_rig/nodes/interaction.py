"""The permitted commands to a lockstep run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:  # python-can is not needed for --help
    from can_rig.nodes.operating import Touch


@dataclass(frozen=True)
class Interaction:
    """How far a run can be touched."""

    injectable: bool = False
    """Whether ``RIG_CONTROL`` is obeyed; otherwise it is counted and refused."""
    pace: float = 0.0
    """Times real time that lockstep is held to; 0: as fast as it can."""
    told: tuple[Touch, ...] = ()
    """Commands of a log: they come where they came, and nobody waits between them."""


UNTOUCHED: Final = Interaction()
