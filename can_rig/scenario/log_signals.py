"""The signals of a recorded drive: signals of a log by quantity, with their units.

A role is ``"Message.Signal"``, a table of a signal with its unit and factor, or a list of both,
whose values are added: the torque of an electric power steering and that of the driver.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any, Final

from pydantic import PlainValidator
from pydantic_core import PydanticCustomError

from can_rig.errors import ScenarioError

RAD, RAD_PER_S, MPS2, MPS, NM, N = "rad", "rad/s", "m/s²", "m/s", "N m", "N"

_DEGREE: Final = math.pi / 180.0
_FACTORS: Final = {
    RAD: {"rad": 1.0, "deg": _DEGREE, "mrad": 1e-3, "unit_degreofarc": _DEGREE},
    RAD_PER_S: {"rad/s": 1.0, "deg/s": _DEGREE, "mrad/s": 1e-3, "unit_degreofarcperseco": _DEGREE},
    MPS2: {"m/s2": 1.0, "g": 9.80665, "mg": 9.80665e-3, "unit_meterperseconsquar": 1.0},
    MPS: {
        "m/s": 1.0,
        "km/h": 1 / 3.6,
        "mph": 0.44704,
        "kn": 1852 / 3600,
        "unit_kilometerperhour": 1 / 3.6,
    },
    NM: {"nm": 1.0, "cnm": 0.01, "dnm": 0.1, "mnm": 1e-3, "knm": 1e3, "unit_newtometer": 1.0},
    N: {"n": 1.0, "kn": 1e3, "dan": 10.0},
}
"""By the unit of a role: the spelling of units, as `_plain` makes it, and their factors. The words
with ``unit_`` are those of Volkswagen's databases."""

_WORDS: Final = (
    ("degrees|degree|°", "deg"),
    ("seconds|second|sec", "s"),
    (r"\^|\*|·|\s|²(?=$)", lambda found: "2" if found[0] == "²" else ""),
    ("/s/s$|/ss$", "/s2"),
    ("^mps2$", "m/s2"),
    ("^mps$", "m/s"),
    ("^(kph|kmh|kmph|km/hr)$", "km/h"),
    ("^n-?m$", "nm"),
)


def unit_factor(role_unit: str, unit: str, where: str) -> float:
    """The factor from ``unit``, as a database spells it, to the unit of a role.

    Raises:
        ScenarioError: an unknown unit; begins with ``where``.
    """
    plain = unit.lower()
    for pattern, word in () if plain.startswith("unit_") else _WORDS:
        plain = re.sub(pattern, word, plain)
    factors = _FACTORS[role_unit]
    if plain not in factors:
        said = f"unit {unit!r}" if unit else "no unit"
        known = ", ".join(each for each in factors if not each.startswith("unit_"))
        raise ScenarioError(f"{where}: has {said}; must be a table with unit = one of {known}")
    return factors[plain]


ROLES: Final = {
    "reference": MPS2,
    "feedback": MPS2,
    "command_1": NM,
    "command_2": N,
    "yaw_rate": RAD_PER_S,
    "lateral_acceleration": MPS2,
    "speed": MPS,
    "torque": NM,
    "force_difference": N,
}
"""Every role of a recorded drive and its unit."""

OF_SENSORS: Final = {
    "yaw_rate": RAD_PER_S,
    "lateral_acceleration": MPS2,
    "steering_angle": RAD,
    "torque_echo": NM,
    "force_difference_echo": N,
}
"""The roles of further sensors and their units."""

OF_A_CAR: Final = ("yaw_rate", "lateral_acceleration", "speed", "torque", "force_difference")
"""The roles that only a recorded drive has; the others are those of a run's frames too."""


@dataclass(frozen=True)
class LogSignal:
    """One signal of a log: its value in the role's unit is ``sign (value · factor) + offset``.

    Attributes:
        signal: ``Message.Signal`` of the database.
        bus: the bus of its frames, as the log names it; "": the only bus that has them.
        unit: in place of the database's unit.
        factor: after the conversion of the unit, as a gear ratio or -1 for the other direction.
        offset: in the unit of the role.
        sign: ``Message.Signal`` of the same message; the value is negative where this is not 0.
    """

    signal: str
    bus: str = ""
    unit: str = ""
    factor: float = 1.0
    offset: float = 0.0
    sign: str = ""

    @property
    def message(self) -> str:
        """The message of the signal."""
        return self.signal.rpartition(".")[0]


_KEYS: Final = {field.name: field.type for field in fields(LogSignal)}


def _bad(text: str) -> PydanticCustomError:
    return PydanticCustomError("signal", "{text}", {"text": text})


def _one(value: Any) -> LogSignal:
    """A signal from a name or a table."""
    if isinstance(value, LogSignal):
        value = asdict(value)
    table = {"signal": value} if isinstance(value, str) else value
    if not isinstance(table, Mapping) or "signal" not in table:
        raise _bad('must be "Message.Signal", a table with signal, or a list of these')
    for key, given in table.items():
        if key not in _KEYS:
            raise _bad(f"{key}: unknown key; known: {', '.join(_KEYS)}")
        number = key in {"factor", "offset"}
        if number and (isinstance(given, bool) or not isinstance(given, int | float)):
            raise _bad(f"{key} = {given!r}: must be a number")
        if number and not math.isfinite(float(given)):
            raise _bad(f"{key} = {given!r}: must be finite")
        if not number and not isinstance(given, str):
            raise _bad(f"{key} = {given!r}: must be a text")
    if table.get("factor") == 0:
        raise _bad("factor = 0: must not be 0")
    made = LogSignal(**table)
    for key, name in (("signal", made.signal), ("sign", made.sign)):
        message, dot, signal = name.rpartition(".")
        if (name or key == "signal") and not (message and dot and signal):
            raise _bad("must be Message.Signal" + (" (sign)" if key == "sign" else ""))
    if made.sign and made.sign.rpartition(".")[0] != made.message:
        raise _bad(f"sign = {made.sign!r}: must be a signal of {made.message}")
    return made


def _role(value: Any) -> str | tuple[LogSignal, ...]:
    """The signals of a role; a name alone stays a name, as a run's frames have it."""
    if isinstance(value, str):
        if value:
            _one(value)
        return value
    listed = value if isinstance(value, list | tuple) else [value]
    if not listed:
        raise _bad("must name at least one signal")
    return tuple(map(_one, listed))


Role = Annotated[str | tuple[LogSignal, ...], PlainValidator(_role, json_schema_input_type=str)]
"""A setting that names the signals of a role; "": none."""


def terms(role: str | tuple[LogSignal, ...]) -> tuple[LogSignal, ...]:
    """The signals whose values a role adds."""
    return ((LogSignal(role),) if role else ()) if isinstance(role, str) else role
