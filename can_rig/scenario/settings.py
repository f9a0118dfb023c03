"""The settings of a scenario: every key, its unit, its default, and what is refused.

Parameters of the car come from ``firmware_model.design.vehicle``; everything else is
declared here, with units in the names. ``loading`` reads them from TOML.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict

from firmware_model.design.vehicle import VehicleParameters
from firmware_model.discretisation.targets import EstimatorRule
from firmware_model.target.structs import MAX_LATENCY_TICKS

FaultKind = Literal["none", "actuator-dead", "frames-missing", "frames-corrupted", "sensor-biased"]
Channel = Literal["torque", "force-difference"]
ReferenceKind = Literal["step", "sine", "lane-change", "csv"]

BUILT_IN = ("steer-by-wire", "chapter-2")  # the plants of the thesis, both linear
MAX_TICKS = 10_000_000  # of a run: a log of 2 GB
MAX_DURATION_S = 1e6
MAX_REFERENCE_MPS2 = 1e6  # far beyond any frame, and its square is still a number


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
        _require(
            0.0 < self.friction <= 10.0, f"friction = {self.friction:g}: above 0 to 10 is right"
        )

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
    fault_threshold_share: float = 0.0
    confirm_s: float = 0.01
    clear_s: float = 0.5
    probe_nm: float = 0.0
    probe_rad_per_s: float = 10.0

    def __post_init__(self) -> None:
        for name in ("tau_s", "tau_q_s", "fault_threshold_mps2"):
            value = getattr(self, name)
            _require(value > 0.0, f"{name} = {value:g}: above 0 is right")
        for name in ("alpha", "alpha_q"):
            value = getattr(self, name)
            _require(1 <= value <= 8, f"{name} = {value}: 1 to 8 is right")
        for name in ("fault_threshold_share", "probe_nm"):
            value = getattr(self, name)
            _require(value >= 0.0, f"{name} = {value:g}: 0 or above is right")
        for name in ("confirm_s", "clear_s"):
            value = getattr(self, name)
            _require(0.0 <= value <= 3600.0, f"{name} = {value:g}: 0 to 3600 is right")
        probe = self.probe_rad_per_s
        _require(probe >= 0.01, f"probe_rad_per_s = {probe:g}: 0.01 or above is right")


@dataclass(frozen=True)
class BudgetSettings(Strict):
    """What ``design.fault_threshold_mps2 = "from-budget"`` has to allow for; see ``budget``.

    ``box`` is by how much mass, both cornering stiffnesses and speed of the car may be off, 0.2 for
    ±20 %.
    """

    box: float = 0.0
    false_alarms_per_hour: float = 0.001

    def __post_init__(self) -> None:
        _require(0.0 <= self.box < 1.0, f"box = {self.box:g}: 0 to below 1 is right")
        _require(
            self.false_alarms_per_hour > 0.0,
            f"false_alarms_per_hour = {self.false_alarms_per_hour:g}: above 0 is right",
        )


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
        frequency, amplitude = self.frequency_rad_per_s, self.amplitude_mps2
        most = MAX_REFERENCE_MPS2
        _require(frequency > 0.0, f"frequency_rad_per_s = {frequency:g}: above 0 is right")
        _require(
            abs(amplitude) <= most,
            f"amplitude_mps2 = {amplitude:g}: {-most:g} to {most:g} is right",
        )
        if self.kind == "csv":
            _require(bool(self.file), 'file: the CSV of a reference of kind "csv" is right')


@dataclass(frozen=True)
class FaultSettings(Strict):
    """One channel lost from ``at_s`` on, for good or for ``for_s`` seconds.

    ``left`` is the share of an ``actuator-dead``'s effect that is not lost. ``sensor-biased`` loses
    none: the sensor adds ``bias_mps2`` to D*, which d̂ takes for a loss.
    """

    kind: FaultKind = "none"
    channel: Channel = "torque"
    at_s: float = 10.0
    for_s: float | None = None
    left: float = 0.0
    bias_mps2: float = 0.1

    def __post_init__(self) -> None:
        _require(0.0 <= self.left < 1.0, f"left = {self.left:g}: 0 (dead) to below 1 is right")
        most = MAX_DURATION_S
        _require(0.0 <= self.at_s <= most, f"at_s = {self.at_s:g}: 0 to {most:g} is right")
        if self.for_s is not None:
            _require(
                0.0 < self.for_s <= most, f"for_s = {self.for_s:g}: above 0 to {most:g} is right"
            )

    @property
    def loses_a_channel(self) -> bool:
        """Whether it takes a channel away, in full or in part, while it is active."""
        return self.kind not in {"none", "sensor-biased"}

    def active(self, time_ns: int) -> bool:
        """Whether the fault is there at ``time_ns``; whole nanoseconds, so no tick by rounding."""
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
        most = MAX_DURATION_S
        _require(0.0 <= self.hold_s <= most, f"hold_s = {self.hold_s:g}: 0 to {most:g} is right")


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
    budget: BudgetSettings = field(default_factory=BudgetSettings)
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
            self.tick_s <= self.duration_s <= MAX_DURATION_S,
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

    @property
    def healthy(self) -> Scenario:
        """The same with nothing lost."""
        return dataclasses.replace(self, fault=dataclasses.replace(self.fault, kind="none"))

    def as_dict(self) -> dict[str, Any]:
        """Every key and value, as a scenario file would have them."""
        return dataclasses.asdict(self)
