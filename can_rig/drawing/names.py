"""What people call the signals of the two networks, and units as print has them."""

from __future__ import annotations

from typing import Final, NamedTuple

from can_rig.frames.network import Network
from can_rig.scenario.settings import FaultSettings


class Names(NamedTuple):
    """One name for each signal, wherever a person reads it."""

    output: str
    command_1: str
    command_2: str

    def lost_by(self, fault: FaultSettings) -> str:
        """The signal that ``fault`` takes away or, of a biased sensor, falsifies."""
        if not fault.loses_a_channel:
            return self.output
        return self.command_1 if fault.channel == "torque" else self.command_2


CAR: Final = Names("D*", "steering torque", "rear force difference")
CHAPTER_2: Final = Names("output y", "input 1", "input 2")


def names_of(network: Network) -> Names:
    """The names of ``network``'s signals: those of a car, or of the abstract plant."""
    return CAR if network.feedback.signal_name == "DStar" else CHAPTER_2


def printed(unit: str) -> str:
    """``unit`` as a DBC has it (``m/s^2``, ``N.m``), as print has it (``m/s²``, ``N m``)."""
    return unit.replace("^2", "²").replace("N.m", "N m")


def ticks_text(ticks: int) -> str:
    """``1 tick``, ``2 ticks``."""
    return f"{ticks} tick" if ticks == 1 else f"{ticks} ticks"
