"""Printed names and units of a plant's signals."""

from __future__ import annotations

from typing import Final, NamedTuple

from can_rig.scenario.fault_settings import CONTROLLER, PLACES, FaultSettings
from can_rig.scenario.plant_settings import PlantSettings, SignalSettings


class Signal(NamedTuple):
    """A signal of the plant, wherever a person reads of it."""

    name: str
    unit: str = ""
    """In print; empty if dimensionless."""
    short: str = ""
    """In the heading of a column."""
    said: str = ""
    """In a sentence."""


class Names(NamedTuple):
    """The signals of a plant."""

    output: Signal
    command_1: Signal
    command_2: Signal

    def hit_by(self, fault: FaultSettings) -> Signal:
        """The signal that ``fault`` takes away or falsifies; of a restart, the controller."""
        if fault.place == CONTROLLER:
            return Signal(CONTROLLER)
        return self[(1, 2, 0)[PLACES.index(fault.place)]]


CAR: Final = Names(
    Signal("D*", "m/s²", "D*", "D*"),
    Signal("steering torque", "N m", "torque", "the torque"),
    Signal("rear force difference", "N", "X_diff", "X_diff"),
)
BY_NUMBERS: Final = ("output y", "input 1", "input 2")
"""Names of signals that the scenario leaves unnamed."""


def names_of(plant: PlantSettings) -> Names:
    """The signals of ``plant``: the car's signals, or the scenario's names."""
    own = CAR if plant.is_car else Names(*(Signal(name, "", name, name) for name in BY_NUMBERS))
    given = (plant.output, plant.input_1, plant.input_2)
    return Names(*(_called(*pair) for pair in zip(own, given, strict=True)))


def _called(own: Signal, given: SignalSettings) -> Signal:
    unit = own.unit if given.unit is None else given.unit
    if given.name is None:
        return own._replace(unit=unit)
    return Signal(given.name, unit, given.name, given.name)


def with_unit(text: str, unit: str) -> str:
    """``text`` with the unit, if any."""
    return f"{text} {unit}".rstrip()


def printed(unit: str) -> str:
    """A DBC unit (``m/s^2``, ``N.m``) in print (``m/s²``, ``N m``)."""
    return unit.replace("^2", "²").replace("N.m", "N m")


def ticks_text(ticks: int) -> str:
    """``1 tick``, ``2 ticks``."""
    return f"{ticks} tick" if ticks == 1 else f"{ticks} ticks"
