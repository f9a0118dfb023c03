"""Printed names and units of a plant's signals; faults and disturbances in words."""

from __future__ import annotations

from typing import Final, NamedTuple

from can_rig.scenario.disturbance_settings import DisturbanceSettings
from can_rig.scenario.fault_settings import CONTROLLER, PLACES, RESTARTED, FaultSettings
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


HOW: Final = {
    "actuator-dead": "lost",
    "sensor-dead": "lost",
    "frames-missing": "lost",
    "frames-corrupted": "lost",
    "sensor-biased": "biased",
    "actuator-drift": "drifting",
    "sensor-drift": "drifting",
}
"""Exceptions to the last part of the kind."""


def fault_label(fault: FaultSettings, names: Names) -> str:
    """Short description of ``fault``."""
    share = f"{100.0 * (1.0 - fault.left):g} % of " if fault.left and "dead" in fault.kind else ""
    how = HOW.get(fault.kind) or fault.kind.partition("-")[2].replace("-", " ")
    return f"{share}{names.hit_by(fault).name} {how}"


def fault_in_words(fault: FaultSettings, names: Names, end_s: float) -> str:
    """Description of ``fault``: kind, size and time, for a run that ends at ``end_s``."""
    every = f", every {ticks_text(fault.every)}" if fault.every > 1 else ""
    when = _when(fault, every, end_s)
    if fault.kind == "sensor-biased":
        return f"{fault_label(fault, names)} {_size(fault, names)} {when}"
    if fault.kind == RESTARTED:
        return f"{fault_label(fault, names)}, without power {when}"
    size = _size(fault, names)
    told = f"{fault_label(fault, names)} {size}".rstrip()
    return f"{told} {when} ({fault.kind.replace('-', ' ')})"


def disturbance_label(disturbance: DisturbanceSettings) -> str:
    """Short description of ``disturbance``: kind and size."""
    of = disturbance
    if of.kind == "friction":
        axles = (("front", of.front), ("rear", of.rear))
        named = [f"{name} axle {factor:g}" for name, factor in axles if factor is not None]
        return f"friction factor of the {' and the '.join(named)}"
    words = {
        "gust": ("gust of", of.force_n, "N"),
        "turbulence": ("turbulence of", of.intensity_n, "N rms"),
        "bank": ("road banked by", of.bank_percent, "%"),
        "steering-kick": ("steering kick of", of.torque_nm, "N m"),
    }
    what, size, unit = words[of.kind]
    return f"{what} {size:g} {unit}"


def disturbance_in_words(disturbance: DisturbanceSettings, end_s: float) -> str:
    """Description of ``disturbance``: kind, size and time, for a run that ends at ``end_s``."""
    return f"{disturbance_label(disturbance)} {_when(disturbance, '', end_s)}"


def _when(what: FaultSettings | DisturbanceSettings, every: str, end_s: float) -> str:
    """The time of a fault or a disturbance."""
    when = f"{'at' if isinstance(what, FaultSettings) else 'from'} {what.at_s:g} s"
    if what.for_s is not None:
        when = f"from {what.at_s:g} s to {what.at_s + what.for_s:g} s"
    return when + every + (", after the end of the run" if what.at_s >= end_s else "")


def _size(fault: FaultSettings, names: Names) -> str:
    """By how much, where a key of the fault says so."""
    unit = names.hit_by(fault).unit
    a_second = f"{unit}/s".lstrip()
    sizes = {
        "biased": ("by", fault.bias_mps2, unit),
        "offset": ("by", fault.offset, unit),
        "drift": ("by", fault.drift_per_s, a_second),
        "oscillating": ("by", fault.amplitude, unit),
        "limited": ("to", fault.rate_per_s, a_second),
        "stuck": ("at", fault.value, unit),
        "forged": ("as", fault.value, unit),
    }
    if fault.kind.endswith("-late"):
        return f"by {ticks_text(fault.late_ticks)}"
    word, value, its_unit = sizes.get(fault.kind.rpartition("-")[2], ("", None, ""))
    return "" if value is None else f"{word} {with_unit(f'{value:g}', its_unit)}"
