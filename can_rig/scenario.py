"""A TOML scenario as a validated, frozen object: the one source of every default of a run.

Parameters of the car come from ``firmware_model.vehicle``; everything else is declared here, with
units in the names. Errors name the scenario and the key.
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, TypeAdapter, ValidationError

from can_rig.errors import RigError, ScenarioError
from firmware_model.errors import DesignError
from firmware_model.layout import MAX_LATENCY_TICKS
from firmware_model.tables import EstimatorRule
from firmware_model.vehicle import VehicleParameters

FaultKind = Literal["none", "actuator-dead", "frames-missing", "frames-corrupted"]
Channel = Literal["torque", "force-difference"]
ReferenceKind = Literal["step", "sine", "lane-change", "csv"]

BUILT_IN = ("steer-by-wire", "chapter-2")  # the plants of the thesis, both linear
MAX_TICKS = 10_000_000  # of a run: a log of 2 GB
FROM_BUS = "from-bus"  # what ``latency_ticks`` may be in a file


class Strict:
    """Tells pydantic to refuse unknown keys, text for numbers, and numbers that are not finite."""

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True)
class PlantSettings(VehicleParameters, Strict):
    """The simulated plant; for ``chapter-2`` the parameters of the car mean nothing.

    ``kind`` is built in or ``package.module:Class``, a plant of one's own (``plant_protocol``).
    ``friction`` μ is what tires can transmit at most, as a part of their load: the linear cars
    ignore it, a nonlinear one saturates with it.
    """

    kind: str = "steer-by-wire"
    variant: Literal["physics", "published"] = "physics"
    friction: float = 0.9

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(
            self.kind in BUILT_IN or self.is_class,
            f"kind = {self.kind!r}: {', '.join(BUILT_IN)} or package.module:Class is right",
        )
        _require(self.friction > 0.0, f"friction = {self.friction:g}: above 0 is right")

    @property
    def is_class(self) -> bool:
        """Whether ``kind`` reads ``package.module:Class``; not whether there is one."""
        module, _, name = self.kind.partition(":")
        return name.isidentifier() and all(part.isidentifier() for part in module.split("."))


@dataclass(frozen=True)
class DesignSettings(Strict):
    """The thesis's tuning knobs and how they are put on the target."""

    tau_s: float = 0.001
    alpha: int = 1
    tau_q_s: float = 0.001
    alpha_q: int = 2
    estimator: EstimatorRule = "tustin"
    compensation: Literal["always", "on-confirmation", "off"] = "always"
    fault_threshold_mps2: float = 0.3
    confirm_s: float = 0.01
    clear_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("tau_s", "tau_q_s", "fault_threshold_mps2"):
            value = getattr(self, name)
            _require(value > 0.0, f"{name} = {value:g}: above 0 is right")
        for name in ("alpha", "alpha_q"):
            value = getattr(self, name)
            _require(1 <= value <= 8, f"{name} = {value}: 1 to 8 is right")
        for name in ("confirm_s", "clear_s"):
            value = getattr(self, name)
            _require(value >= 0.0, f"{name} = {value:g}: 0 or above is right")


@dataclass(frozen=True)
class ReferenceSettings(Strict):
    """What D* shall follow; ``reference`` has the shapes.

    ``csv`` reads two columns, time in s and reference in m/s².
    """

    kind: ReferenceKind = "step"
    amplitude_mps2: float = 1.0
    frequency_rad_per_s: float = 5.0
    file: str = ""

    def __post_init__(self) -> None:
        frequency = self.frequency_rad_per_s
        _require(frequency > 0.0, f"frequency_rad_per_s = {frequency:g}: above 0 is right")
        if self.kind == "csv":
            _require(bool(self.file), 'file: the CSV of a reference of kind "csv" is right')


@dataclass(frozen=True)
class FaultSettings(Strict):
    """One channel lost from ``at_s`` on, for good or for ``for_s`` seconds.

    ``left`` is the share of an ``actuator-dead``'s effect that is not lost.
    """

    kind: FaultKind = "none"
    channel: Channel = "torque"
    at_s: float = 10.0
    for_s: float | None = None
    left: float = 0.0

    def __post_init__(self) -> None:
        _require(0.0 <= self.left < 1.0, f"left = {self.left:g}: 0 (dead) to below 1 is right")
        _require(self.at_s >= 0.0, f"at_s = {self.at_s:g}: 0 or above is right")
        if self.for_s is not None:
            _require(self.for_s > 0.0, f"for_s = {self.for_s:g}: above 0 is right")

    def active(self, time_ns: int) -> bool:
        """Whether the channel is lost at ``time_ns``; whole nanoseconds, so no tick by rounding."""
        start_ns = round(self.at_s * 1e9)
        if self.kind == "none" or time_ns < start_ns:
            return False
        return self.for_s is None or time_ns < start_ns + round(self.for_s * 1e9)


@dataclass(frozen=True)
class NoiseSettings(Strict):
    """White noise on the measured D*, drawn from the scenario's seed."""

    dstar_rms_mps2: float = 0.0

    def __post_init__(self) -> None:
        _require(
            self.dstar_rms_mps2 >= 0.0,
            f"dstar_rms_mps2 = {self.dstar_rms_mps2:g}: 0 or above is right",
        )


@dataclass(frozen=True)
class LimitSettings(Strict):
    """Largest commands and rates of commands; without one, the range of the frame limits it."""

    torque_nm: float | None = None
    torque_rate_nm_per_s: float | None = None
    force_difference_n: float | None = None
    force_difference_rate_n_per_s: float | None = None

    def __post_init__(self) -> None:
        for limit in dataclasses.fields(self):
            value = getattr(self, limit.name)
            _require(value is None or value > 0.0, f"{limit.name} = {value}: above 0 is right")


@dataclass(frozen=True)
class ActuatorSettings(Strict):
    """What an actuator does that hears no valid command: hold the last one, then apply zero."""

    hold_s: float = 0.01

    def __post_init__(self) -> None:
        _require(self.hold_s >= 0.0, f"hold_s = {self.hold_s:g}: 0 or above is right")


@dataclass(frozen=True)
class BusSettings(Strict):
    """The bus that ``latency_ticks = "from-bus"`` asks for the latency; see ``bus_timing``."""

    bitrate: int = 1_000_000
    compute_s: float = 0.0002

    def __post_init__(self) -> None:
        _require(
            1_000 <= self.bitrate <= 1_000_000,  # bit/s; classic frames know no more
            f"bitrate = {self.bitrate}: 1000 to 1000000 (bit/s) is right",
        )
        _require(self.compute_s >= 0.0, f"compute_s = {self.compute_s:g}: 0 or above is right")


@dataclass(frozen=True)
class Scenario(Strict):
    """One run, whole. ``name`` is the file's own and no key of it."""

    name: str
    description: str = ""
    tick_s: float = 0.001
    duration_s: float = 20.0
    latency_ticks: int = 0
    seed: int = 0
    plant: PlantSettings = field(default_factory=PlantSettings)
    model: PlantSettings = field(default_factory=PlantSettings)
    design: DesignSettings = field(default_factory=DesignSettings)
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)
    fault: FaultSettings = field(default_factory=FaultSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)
    actuator: ActuatorSettings = field(default_factory=ActuatorSettings)
    bus: BusSettings = field(default_factory=BusSettings)

    def __post_init__(self) -> None:
        _require(
            1e-5 <= self.tick_s <= 1.0,
            f"tick_s = {self.tick_s:g}: 1e-5 (10 µs, which five frames share) to 1 is right",
        )
        nanoseconds = self.tick_s * 1e9
        _require(
            abs(nanoseconds - round(nanoseconds)) < 1e-3,
            f"tick_s = {self.tick_s!r}: a whole number of nanoseconds is right",
        )
        _require(
            self.tick_s <= self.duration_s <= 1e6,
            f"duration_s = {self.duration_s:g}: one tick ({self.tick_s:g} s) to 1e6 s is right",
        )
        _require(
            self.ticks <= MAX_TICKS,
            f"duration_s = {self.duration_s:g}: at most {MAX_TICKS} ticks ({self.tick_s:g} s each) "
            "are right",
        )
        _require(
            0 <= self.latency_ticks <= MAX_LATENCY_TICKS,
            f"latency_ticks = {self.latency_ticks}: 0 to {MAX_LATENCY_TICKS} is right",
        )
        _require(self.seed >= 0, f"seed = {self.seed}: 0 or above is right")
        _require(
            not self.model.is_class,
            f"model.kind = {self.model.kind!r}: a linear car, {' or '.join(BUILT_IN)}, is right",
        )

    @property
    def tick_ns(self) -> int:
        """The tick in whole nanoseconds, the unit of virtual time."""
        return round(self.tick_s * 1e9)

    @property
    def ticks(self) -> int:
        """Ticks of the whole run."""
        return math.floor(self.duration_s * 1e9 / self.tick_ns + 1e-6)

    @property
    def dbc(self) -> str:
        """File name of the network's DBC in ``dbc/``; a plant of one's own is a car."""
        return "chapter_2.dbc" if self.plant.kind == "chapter-2" else "steer_by_wire.dbc"

    def as_dict(self) -> dict[str, Any]:
        """Every key and value, as a scenario file would have them."""
        return dataclasses.asdict(self)


def shipped() -> dict[str, Path]:
    """Name → file of the scenarios that come with the package, sorted."""
    folder = Path(str(files("can_rig"))) / "scenarios"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load(name: str, settings: Iterable[str] = ()) -> Scenario:
    """The scenario ``name``, a shipped one or a path to a TOML file, with ``KEY=VALUE`` changes.

    Raises:
        ScenarioError: no such scenario, not TOML, an unknown key, a bad value.
    """
    known = shipped()
    path = Path(name)
    if name in known:
        path = known[name]
    elif not path.is_file():
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"shipped ones: {', '.join(known)}"
        raise ScenarioError(f"scenario {name}: no such scenario and no such file; {hint}")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ScenarioError(f"scenario {name}: not readable as TOML: {error}") from None
    table = values.get("reference")
    if isinstance(table, dict) and isinstance(table.get("file"), str):
        # in a scenario relative to it, as everywhere else; in --set to the working directory
        table["file"] = str(path.parent / table["file"])
    for setting in settings:
        _change(values, setting)
    if "name" in values:
        raise ScenarioError(f"scenario {name}: name: unknown key; a scenario is named by its file")
    return from_dict(path.stem, values)


def from_dict(name: str, values: Mapping[str, Any]) -> Scenario:
    """A scenario from plain values; ``model`` is the plant's own but for the keys it names.

    What the controller believes in is linear: of a plant of one's own, the thesis's car with the
    same parameters.

    ``latency_ticks`` may be ``"from-bus"`` here; the scenario has the number that follows.

    Raises:
        ScenarioError: an unknown key, a bad value; the message names the key.
    """
    merged = {key: value for key, value in values.items() if key != "name"}
    plant, model = merged.get("plant", {}), merged.get("model", {})
    if isinstance(plant, Mapping) and isinstance(model, Mapping):
        linear = {"kind": BUILT_IN[0]} if ":" in str(plant.get("kind")) else {}
        merged["model"] = {**plant, **linear, **model}
    from_bus = merged.get("latency_ticks") == FROM_BUS
    if from_bus:
        merged["latency_ticks"] = 0  # until the rest, on which it depends, is known to be right
    try:
        # As JSON, where strict still takes a table for a dataclass and a whole number for a float.
        scenario = _ADAPTER.validate_json(json.dumps({"name": name, **merged}, default=str))
    except ValidationError as error:
        raise ScenarioError(f"scenario {name}: {_first_line(error)}") from None
    except DesignError as error:
        raise ScenarioError(f"scenario {name}: plant: {error}") from None
    return _with_latency_of_bus(scenario) if from_bus else scenario


def _with_latency_of_bus(scenario: Scenario) -> Scenario:
    from can_rig.bus_timing import latency_ticks  # noqa: PLC0415 (cantools: slow to import)
    from can_rig.nodes import network_of  # noqa: PLC0415 (imports this module)

    network, bus = network_of(scenario), scenario.bus
    try:
        ticks = latency_ticks(network, bus.bitrate, scenario.tick_s, bus.compute_s)
        return dataclasses.replace(scenario, latency_ticks=ticks)
    except (RigError, ValueError) as error:
        where = f'scenario {scenario.name}: latency_ticks = "{FROM_BUS}"'
        raise ScenarioError(f"{where}: {error}") from None


_ADAPTER = TypeAdapter(Scenario)


def _change(values: dict[str, Any], setting: str) -> None:
    """Apply one ``KEY=VALUE``; a value that is not TOML is a string, so quotes are optional."""
    key, equals, text = setting.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ScenarioError(f"--set {setting}: KEY=VALUE is right, as in plant.speed_mps=20")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    table = values
    for part in parts[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise ScenarioError(f"--set {setting}: {part} is a value and has no keys")
    table[parts[-1]] = value


def _first_line(error: ValidationError) -> str:
    """pydantic's first finding as ``key: what is wrong; what would be right``."""
    finding = error.errors()[0]
    location = [str(part) for part in finding["loc"]]
    key = ".".join(location)
    if finding["type"] == "unexpected_keyword_argument":
        near = difflib.get_close_matches(location[-1], _keys(location[:-1]), n=1, cutoff=0.5)
        known = ", ".join(_keys(location[:-1]))
        return f"{key}: unknown key; " + (f"did you mean {near[0]}?" if near else f"known: {known}")
    message = finding["msg"].removeprefix("Value error, ")
    if finding["type"] == "value_error":
        return f"{key}.{message}" if key else message
    return f"{key} = {finding['input']!r}: {message[0].lower()}{message[1:]}"


def _keys(location: list[str]) -> list[str]:
    """Key names of the table at ``location``."""
    kind: Any = Scenario
    for part in location:
        default = next(f.default_factory for f in dataclasses.fields(kind) if f.name == part)
        kind = default
    return [f.name for f in dataclasses.fields(kind) if f.name != "name"]
