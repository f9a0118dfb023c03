"""Printed names and units of a plant's signals; faults and disturbances in words; columns.

Within the rig every plant has the columns of the car (``logs.columns``). In ``signals.csv``,
``torque_nm`` must be a torque in N m, so for any other plant the columns have the names and units
of the scenario's signals.
"""

import re
from collections.abc import Container, Sequence
from typing import Final, NamedTuple

from can_rig.logs.columns import APPLIED, EVIDENCE, EVIDENCE_OF, TAKEN, TRUE_OUTPUT
from can_rig.scenario.disturbance_settings import PUSH, DisturbanceSettings
from can_rig.scenario.fault_settings import CONTROLLER, PLACES, RESTARTED, FaultSettings, key_of
from can_rig.scenario.plant_settings import PlantSettings, SignalSettings
from can_rig.scenario.sensor_settings import ECHOES, MEASURED, USUAL


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
        return self.at(fault.place)

    def at(self, place: str) -> Signal:
        """The signal of an actuator or a sensor, by the word of a fault's place."""
        if place in MEASURED:
            if place in OUTPUTS and self != CAR:
                return Signal(OUTPUTS[place])
            units = ("rad/s", "m/s²", "rad", self.command_1.unit, self.command_2.unit)
            return Signal(place.replace("-", " "), units[MEASURED.index(place)])
        return self[(1, 2, 0)[PLACES.index(place)]]


CAR: Final = Names(
    Signal("D*", "m/s²", "D*", "D*"),
    Signal("steering torque", "N m", "torque", "the torque"),
    Signal("rear force difference", "N", "X_diff", "X_diff"),
)
OUTPUTS: Final = {
    each: f"output {number}" for number, each in enumerate(MEASURED[: -len(ECHOES)], start=2)
}
"""Names of the further outputs of a plant other than a car, by their sensors."""
OUTPUT_COLUMNS: Final = {
    USUAL[each].column: f"measured_{name.replace(' ', '_')}" for each, name in OUTPUTS.items()
}
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


_UNITS: Final = {  # by the last word of a column, or by the words around "per"
    "hz": "Hz", "hour": "h", "kg": "kg", "kgm2": "kg m²", "m": "m", "mps": "m/s", "mps2": "m/s²",
    "n": "N", "nm": "N m", "nms": "N m s", "percent": "%", "rad": "rad", "s": "s",
}  # fmt: skip


def in_words(column: str) -> tuple[str, str]:
    """The name of a column or a metric without its unit, and the unit; "" without a unit."""
    unit, words = unit_of(column), column.split("_")
    if unit:
        over = 3 if "per" in words[-2:-1] and words[-1] != "hour" else 1
        words = words[: -2 if words[-1] == "hour" else -over]
    return " ".join(words), unit


def metric_in_words(metric: str, names: Names) -> tuple[str, str]:
    """The name of a metric and its unit, with the names and units of the plant's signals."""
    words, unit = in_words(metric)
    units = {of_car.unit: own.unit for of_car, own in zip(CAR, names, strict=True)}
    if names.output.unit != CAR.output.unit:
        units["m/s"] = f"{names.output.unit} s".lstrip()  # of an integral
    own = {"dstar": names[0].name, "torque": names[1].name, "force difference": names[2].name}
    words = re.sub("|".join(own), lambda found: own[found[0]], words)
    return words, units.get(unit, unit)


def unit_of(column: str) -> str:
    """The unit of a column by the suffix of its name; "" without a unit."""
    *before, last = column.split("_")
    if not before or last not in _UNITS:
        return ""
    if before[-1] != "per":
        return _UNITS[last]
    over = _UNITS.get("".join(before[-2:-1]), "1" if last == "hour" else "")
    return f"{over}/{_UNITS[last]}" if over else ""


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


NUMBERS: Final = {
    "left": ("share left, 0 to 1", "", ""),
    "value": ("value", "{unit}", "at"),
    "offset": ("offset", "{unit}", "by"),
    "drift_per_s": ("drift", "{unit}/s", "by"),
    "amplitude": ("amplitude", "{unit}", "by"),
    "rate_per_s": ("rate", "{unit}/s", "to"),
    "late_ticks": ("delay", "ticks", "by"),
    "bias_mps2": ("bias", "{unit}", "by"),
    "gain": ("gain", "", "by"),
}
"""By the key of a fault's number: its name, its unit, and the word before it in a sentence."""


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
        PUSH: ("push of", of.size, ""),
    }
    what, size, unit = words[of.kind]
    return f"{what} {size:g} {unit}".rstrip()


def disturbance_in_words(disturbance: DisturbanceSettings, end_s: float) -> str:
    """Description of ``disturbance``: kind, size and time, for a run that ends at ``end_s``."""
    return f"{disturbance_label(disturbance)} {_when(disturbance, '', end_s)}"


def _when(what: FaultSettings | DisturbanceSettings, every: str, end_s: float) -> str:
    """The time of a fault or a disturbance."""
    when = f"{'at' if isinstance(what, FaultSettings) else 'from'} {what.at_s:g} s"
    if what.for_s is not None:
        when = f"from {what.at_s:g} s to {what.end_s:g} s"
    return when + every + (", after the end of the run" if what.at_s >= end_s else "")


def _size(fault: FaultSettings, names: Names) -> str:
    """By how much, where a key of the fault says so."""
    if fault.other is not None:
        return f"with {fault.other.replace('-', ' ')}"
    if fault.kind.endswith("-late"):
        return f"by {ticks_text(fault.late_ticks)}"
    key = key_of(fault.kind, fault.place)
    value = getattr(fault, key) if key else None
    if value is None or key == "left":  # the label says the share
        return ""
    _, unit, word = NUMBERS[key]
    if fault.kind == "frames-forged":
        word = "as"
    return f"{word} {with_unit(f'{value:g}', unit.format(unit=names.hit_by(fault).unit))}"


OF_CAR: Final = {
    CAR.output: ("dstar", "_mps2"),
    CAR.command_1: ("torque", "_nm"),
    CAR.command_2: ("force_difference", "_n"),
}
"""Stem and ending of the columns of the car's signals."""

ROLES: Final = ("output", "input_1", "input_2")
"""Stems where the names are no good: no ASCII letter, or a duplicate column name."""

UNIT_WORDS: Final = {"%": "percent", "°": "deg", "²": "2", "³": "3", "µ": "u", "Ω": "ohm"}


def column_names(plant: PlantSettings, further: Container[str] = ()) -> dict[str, str]:
    """The name in the file of each column with a signal of ``plant``, by the car's name.

    Args:
        plant: the plant.
        further: further names in use: a user's plant may report any signal.
    """
    signals = names_of(plant)
    endings = [OF_CAR[each][1] if each in OF_CAR else _ending(each.unit) for each in signals]
    stems = [OF_CAR[each][0] if each in OF_CAR else _word(each.name) for each in signals]
    outputs = {} if plant.is_car else OUTPUT_COLUMNS
    names = _columns(stems, endings) | outputs
    others = set(TAKEN) - set(names)
    if not all(stems) or len({*names.values()} - others) < len(names):
        names = _columns(ROLES, endings) | outputs
    return {column: column if name in further else name for column, name in names.items()}


OF_SIGNALS: Final = {
    "reference_mps2": (0, "reference", "reference"),
    "dstar_mps2": (0, "{}", "{}"),
    "error_mps2": (0, "error", "error"),
    "torque_nm": (1, "{}", "{}"),
    "force_difference_n": (2, "{}", "{}"),
    "fault_estimate_mps2": (0, "fault_estimate", "fault estimate"),
    TRUE_OUTPUT: (0, "true_{}", "true {}"),
    APPLIED[0]: (1, "applied_{}", "{} as applied"),
    APPLIED[1]: (2, "applied_{}", "{} as applied"),
}
"""Columns with a signal of the plant: which, the column's stem, and its name in print."""


def _columns(stems: Sequence[str], endings: Sequence[str]) -> dict[str, str]:
    return {
        **{
            column: stem.format(stems[of]) + endings[of]
            for column, (of, stem, _) in OF_SIGNALS.items()
        },
        **{
            USUAL[echo].column: f"{stem}_echo{ending}"
            for echo, stem, ending in zip(ECHOES, stems[1:], endings[1:], strict=True)
        },
        **{column: _evidence(column, stems) for column in EVIDENCE},
    }


def _evidence(column: str, stems: Sequence[str]) -> str:
    """The evidence for the failure of an actuator, by its name; for the car, unchanged."""
    of, _, failed = column.removeprefix(EVIDENCE_OF).partition("_")
    stem = {"torque": stems[1], "force": stems[2]}.get(of, of)
    return f"{EVIDENCE_OF}{'force' if stem == OF_CAR[CAR.command_2][0] else stem}_{failed}"


def _ending(unit: str) -> str:
    """``mol/s`` as ``_mol_per_s``, ``N m`` as ``_nm``; empty without a unit."""
    for sign, word in UNIT_WORDS.items():
        unit = unit.replace(sign, word)
    parts = [_word(part).replace("_", "") for part in unit.split("/")]
    return "_" + "_per_".join(parts) if all(parts) else ""


def _word(text: str) -> str:
    """``text`` in small letters, digits and _."""
    return re.sub("[^0-9a-z]+", "_", text.lower()).strip("_")
