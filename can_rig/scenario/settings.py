"""The settings of a scenario: every key, unit, default and bound.

``plant_settings`` has the plant's keys, ``fault_settings`` a fault's. A value out of bounds raises
pydantic's ``ValidationError``; ``loading`` turns the error into a line with the key.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Final, Literal, get_args, get_origin, get_type_hints

from pydantic import Field, NonNegativeFloat, PositiveFloat
from pydantic.dataclasses import dataclass

from can_rig.scenario.controller_settings import ControllerSettings
from can_rig.scenario.disturbance_settings import NEEDED, PUSH, DisturbanceSettings
from can_rig.scenario.fault_settings import (
    CHANNELS,
    MAX_DURATION_S,
    PLACES,
    SENSOR,
    FaultSettings,
    Moment,
    Outage,
    Spell,
    outages,
)
from can_rig.scenario.log_signals import OF_A_CAR, OF_SENSORS, Role
from can_rig.scenario.plant_settings import (
    BUILT_IN,
    CAR,
    NUMBERS,
    PUSHED_BY,
    SIGNALS,
    STATE_SPACE,
    STRICT,
    TRANSFER_FUNCTIONS,
    PlantSettings,
    SignalSettings,
    flat,
)
from can_rig.scenario.sensor_settings import (
    ECHOES,
    HEARD,
    LATERAL_ACCELERATION,
    MEASURED,
    YAW_RATE,
    FurtherSensor,
    Measured,
)
from firmware_model.design.vehicle import VehicleParameters
from firmware_model.discretisation.rules import Rule
from firmware_model.law.structs import MAX_LATENCY_TICKS, Precision

SLOWEST_DESIGN_MPS: Final = 1.0  # at lower speeds a torque hardly turns the car
FASTEST_MPS: Final = 100.0

LISTS: Final[dict[str, Any]] = {
    "fault": FaultSettings(),
    "disturbance": DisturbanceSettings("none"),
    "sensor": FurtherSensor("yaw-rate"),
}
"""Keys with a table or a list of tables, and the table with which a further number begins."""

Speed = Annotated[float, Field(ge=0.0, le=FASTEST_MPS)]
DesignSpeed = Annotated[float, Field(ge=SLOWEST_DESIGN_MPS, le=FASTEST_MPS)]


@dataclass(frozen=True, config=STRICT)
class DriveSettings:
    """The car's speed, by at most one of three keys; the controller hears the speed on the bus.

    ``speed_mps`` is constant; ``ramps`` has pairs of time in s and speed in m/s, joined by straight
    lines; ``file`` is a CSV of these two columns, perhaps with the world's inputs beside them.
    Before the first and after the last pair the speed stays. Without any key, the speed is
    ``plant.speed_mps``, and no frame carries the speed.
    """

    speed_mps: Speed | None = None
    ramps: tuple[tuple[Moment, Speed], ...] | None = None
    file: str = ""
    speed_rate_max_mps2: PositiveFloat = 8.0
    gap_max_s: PositiveFloat = 10.0

    def __post_init__(self) -> None:
        given = [key for key in ("speed_mps", "ramps", "file") if self._has(key)]
        if len(given) > 1:
            raise ValueError(f"{given[1]}: must not stand beside {given[0]}; a drive has one speed")
        times = [time_s for time_s, _ in self.ramps or ()]
        for before, after in itertools.pairwise(times):
            if not after > before:
                raise ValueError(f"ramps: time {after:g} s after {before:g} s: times must increase")

    @property
    def is_given(self) -> bool:
        """Whether the scenario has a drive."""
        return any(map(self._has, ("speed_mps", "ramps", "file")))

    def _has(self, key: str) -> bool:
        return getattr(self, key) not in (None, (), "")


DataId = Annotated[int, Field(ge=1, le=0xFFFF)]
"""Of AUTOSAR E2E profile 1."""
OPTIONAL: Final = ("mode", "fault_state", "verdict")


def _require_all(names: Mapping[str, Any], others: str) -> None:
    """Refuse a missing name, except those in ``OPTIONAL``."""
    for key, name in names.items():
        if not name and key not in OPTIONAL:
            raise ValueError(f"{key}: must be set beside the other {others}")


@dataclass(frozen=True, config=STRICT)
class SignalNames:
    """The signal of each role, as ``Message.Signal``.

    A run needs the first five, whose frames the nodes send. A recorded drive needs ``feedback``, or
    ``yaw_rate``, ``lateral_acceleration`` and ``speed``; and ``torque`` as measured, or
    ``command_1`` as sent. Its roles may be tables with a unit and a factor, and lists, whose values
    are added. A run with further sensors needs the role of each, perhaps with a unit and a factor.
    """

    reference: Role = ""
    feedback: Role = ""
    command_1: Role = ""
    command_2: Role = ""
    fault_estimate: str = ""
    mode: str = ""
    fault_state: str = ""
    verdict: str = ""
    yaw_rate: Role = ""
    lateral_acceleration: Role = ""
    speed: Role = ""
    torque: Role = ""
    force_difference: Role = ""
    steering_angle: Role = ""
    torque_echo: Role = ""
    force_difference_echo: Role = ""

    def __post_init__(self) -> None:
        for key in ("fault_estimate", *OPTIONAL):
            name = getattr(self, key)
            message, dot, signal = name.partition(".")
            if name and not (message and dot and signal):
                raise ValueError(f"{key} = {name!r}: must be Message.Signal")
        if not self.are_of_a_drive:
            _require_all(self._given() if self else {}, "signals, as Message.Signal")
            return
        for key in () if self.feedback else ("yaw_rate", "lateral_acceleration", "speed"):
            if not getattr(self, key):
                raise ValueError(f"{key}: must be set, for D* of a recorded drive, or feedback")
        if not (self.torque or self.command_1):
            raise ValueError("torque: must be set, the measured input of a recorded drive")

    def _given(self) -> dict[str, Any]:
        further = {*OF_A_CAR, *OF_SENSORS}
        return {key: name for key, name in vars(self).items() if key not in further}

    @property
    def of_frames(self) -> dict[str, str]:
        """The names of a run's frames by role; empty for the signals of a recorded drive alone."""
        given = self._given()
        whole = all(
            isinstance(name, str) and (name or key in OPTIONAL) for key, name in given.items()
        )
        return given if whole else {}

    @property
    def are_of_a_drive(self) -> bool:
        """Whether the roles are those of a recorded drive, and not of a run's frames."""
        alone = () if self.of_frames else OF_A_CAR
        return any(getattr(self, key) for key in {*OF_A_CAR[2:], *alone})

    def __bool__(self) -> bool:
        """Whether any name is given."""
        return any(vars(self).values())


@dataclass(frozen=True, config=STRICT)
class TickNames:
    """The tick-counting signal in each role's message: for all roles or no role."""

    reference: str = ""
    feedback: str = ""
    command_1: str = ""
    command_2: str = ""
    status: str = ""

    def __post_init__(self) -> None:
        _require_all(vars(self) if self else {}, "ticks")

    def __bool__(self) -> bool:
        """Whether any name is given."""
        return any(vars(self).values())


@dataclass(frozen=True, config=STRICT)
class DataIds:
    """E2E data identifiers of messages with profile 1 protection, by role."""

    reference: DataId | None = None
    feedback: DataId | None = None
    command_1: DataId | None = None
    command_2: DataId | None = None
    status: DataId | None = None
    yaw_rate: DataId | None = None
    lateral_acceleration: DataId | None = None
    steering_angle: DataId | None = None
    torque_echo: DataId | None = None
    force_difference_echo: DataId | None = None


@dataclass(frozen=True, config=STRICT)
class NetworkSettings:
    """The user's frames in place of the rig's.

    ``dbc`` is any database that cantools reads. With ``signals``, the database's frames are used
    unchanged; without ``signals``, the database must have RigRole and the rig's layout. ``tick``
    names the tick-counting signal common to all five messages; ``ticks`` gives a name for each
    message; without both, no message counts ticks.
    """

    dbc: str = ""
    tick: str = ""
    ticks: TickNames = TickNames()
    signals: SignalNames = SignalNames()
    data_ids: DataIds = DataIds()

    def __post_init__(self) -> None:
        if self.signals and not self.dbc:
            raise ValueError("dbc: must name the database of network.signals")
        if self.tick and self.ticks:
            raise ValueError("ticks: must not be set beside network.tick")
        others = (
            self.tick
            or self.ticks
            or any(number is not None for number in vars(self.data_ids).values())
        )
        if others and not self.signals.of_frames:
            raise ValueError("signals: must be set beside network.tick, ticks and data_ids")


ReferenceKind = Literal["step", "sine", "lane-change", "driver", "csv", "samples"]

MAX_TICKS = 10_000_000  # of a run: a log of 2 GB
MAX_REFERENCE_MPS2 = 1e6  # far beyond any frame, and with a finite square
Reference = Annotated[float, Field(ge=-MAX_REFERENCE_MPS2, le=MAX_REFERENCE_MPS2)]

TimeConstant = Annotated[float, Field(ge=1e-9, le=1e6)]  # its powers are floats

Order = Annotated[int, Field(ge=1, le=8)]
"""Of a low-pass filter."""


@dataclass(frozen=True, config=STRICT)
class DesignSettings:
    """The thesis's tuning knobs, and their discretisation for the target."""

    tau_s: TimeConstant = 0.001
    alpha: Order = 1
    tau_q_s: TimeConstant = 0.001
    alpha_q: Order = 2
    feedback: bool = True
    estimator: Rule = "tustin"
    compensation: Literal["always", "on-confirmation", "off"] = "always"
    supervision: Literal["full", "none"] = "full"
    safe_stop_s: NonNegativeFloat = 0.2
    precision: Precision = "float64"
    speeds_mps: tuple[DesignSpeed, ...] | None = None

    def __post_init__(self) -> None:
        if self.supervision == "none" and self.compensation == "on-confirmation":
            raise ValueError(
                'compensation = \'on-confirmation\': must be "always" or "off"; without a '
                "supervision no loss is confirmed"
            )


@dataclass(frozen=True, config=STRICT)
class BudgetSettings:
    """Margins for the decision on d̂.

    ``box`` is the uncertainty of the car's mass, both cornering stiffnesses and speed, 0.2 for ±20
    %; ``actuator_box`` likewise for the lags of both actuators. At most ``false_alarms_per_hour``
    losses are confirmed by chance; ``suspicions_per_hour`` are suspected for a few ticks. Wind,
    road and drifts move a healthy D* by ``disturbance_mps2`` (rms) within a second, and
    a gust by ``gust_mps2`` at most within a third of a second.
    With a peak |S| above ``peak_sensitivity``, or fewer than ``spare_ticks`` of further delay, a
    stable loop has a thin margin.
    """

    box: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.2
    actuator_box: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    false_alarms_per_hour: PositiveFloat = 0.001
    suspicions_per_hour: PositiveFloat = 3600.0
    disturbance_mps2: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    gust_mps2: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    peak_sensitivity: Annotated[float, Field(gt=1.0)] = 5.0
    spare_ticks: Annotated[int, Field(ge=0, le=MAX_LATENCY_TICKS)] = 0


@dataclass(frozen=True, config=STRICT)
class ReferenceSettings:
    """The reference of D*; ``reference`` has the shapes.

    ``csv`` has two columns: time in s, reference in m/s². ``samples`` has a value for each tick;
    the last one stays. ``driver`` changes to the other of two lanes, ``lane_m`` apart, at each of
    ``lane_changes_s``.
    """

    kind: ReferenceKind = "step"
    amplitude_mps2: Reference = 1.0
    frequency_rad_per_s: PositiveFloat = 5.0
    file: str = ""
    samples_mps2: tuple[Reference, ...] | None = None
    lane_changes_s: tuple[Moment, ...] | None = None
    lane_m: Annotated[float, Field(gt=0.0, le=100.0)] = 3.5
    preview_s: Annotated[float, Field(ge=0.1, le=10.0)] = 2.0
    reaction_s: Annotated[float, Field(ge=0.01, le=1.0)] = 0.2

    def __post_init__(self) -> None:
        if self.kind == "driver" and not self.lane_changes_s:
            raise ValueError('lane_changes_s: must have a time for a reference of kind "driver"')
        if self.kind == "driver" and self.amplitude_mps2 <= 0.0:
            raise ValueError(
                f"amplitude_mps2 = {self.amplitude_mps2:g}: must be greater than 0 for a reference "
                'of kind "driver"'
            )
        if self.kind == "csv" and not self.file:
            raise ValueError('file: must name the CSV file of a reference of kind "csv"')
        if self.kind == "samples" and not self.samples_mps2:
            raise ValueError('samples_mps2: must have a value for a reference of kind "samples"')


@dataclass(frozen=True, config=STRICT)
class LimitSettings:
    """Largest commands and command rates of the controller, and its longest time without an input.

    The controller assumes equal limits of the actuators; ``plant.torque_actuator.limit_nm`` and
    similar keys set the actuators' limits. Without a limit, the frame's range limits the command.
    """

    torque_nm: PositiveFloat | None = None
    torque_rate_nm_per_s: PositiveFloat | None = None
    force_difference_n: PositiveFloat | None = None
    force_difference_rate_n_per_s: PositiveFloat | None = None
    blind_s: Moment = 1.0
    monitor: bool = True


@dataclass(frozen=True, config=STRICT)
class ActuatorSettings:
    """An actuator's reaction to missing valid commands: hold the last command, then apply zero."""

    hold_s: Moment = 0.01


@dataclass(frozen=True, config=STRICT)
class BusSettings:
    """The bus from which ``latency_ticks = "from-bus"`` follows; see ``frames.bus_timing``."""

    bitrate: Annotated[int, Field(ge=1_000, le=1_000_000)] = 1_000_000  # maximum of classic frames
    compute_s: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0002


@dataclass(frozen=True, config=STRICT)
class Scenario:
    """A complete run. ``name`` derives from the file name; no key sets ``name``."""

    name: str
    description: str = ""
    tick_s: Annotated[float, Field(ge=1e-5, le=1.0)] = 0.001  # 10 µs, which five frames share
    duration_s: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S)] = 20.0
    latency_ticks: Annotated[int, Field(ge=0, le=MAX_LATENCY_TICKS)] = 0
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0  # as a table has it
    plant: PlantSettings = PlantSettings()
    model: PlantSettings = PlantSettings()
    controller: ControllerSettings = ControllerSettings()
    design: DesignSettings = DesignSettings()
    budget: BudgetSettings = BudgetSettings()
    reference: ReferenceSettings = ReferenceSettings()
    drive: DriveSettings = DriveSettings()
    fault: tuple[FaultSettings, ...] = (FaultSettings(),)
    disturbance: tuple[DisturbanceSettings, ...] = ()
    sensor: tuple[FurtherSensor, ...] = ()
    limits: LimitSettings = LimitSettings()
    actuator: ActuatorSettings = ActuatorSettings()
    network: NetworkSettings = NetworkSettings()
    bus: BusSettings = BusSettings()

    def __post_init__(self) -> None:
        nanoseconds = self.tick_s * 1e9
        if abs(nanoseconds - round(nanoseconds)) >= 1e-3:
            raise ValueError(f"tick_s = {self.tick_s!r}: must be a whole number of nanoseconds")
        if self.duration_s < self.tick_s:
            least = f"must be at least one tick ({self.tick_s:g} s)"
            raise ValueError(f"duration_s = {self.duration_s:g}: {least}")
        if self.ticks > MAX_TICKS:
            raise ValueError(
                f"duration_s = {self.duration_s:g}: must be at most {MAX_TICKS} ticks "
                f"({self.tick_s:g} s each)"
            )
        if self.model.is_own:
            linear = f"must be linear, {' or '.join(BUILT_IN)}"
            raise ValueError(f"model.kind = {self.model.kind!r}: {linear}")
        for key in SIGNALS:
            if getattr(self.model, key) != SignalSettings():
                raise ValueError(f"model.{key}: must be plant.{key}; a signal has one name")
        for key in PUSHED_BY.values():
            if getattr(self.model, key):
                raise ValueError(f"model.{key}: must be plant.{key}; the controller knows no push")
        _refuse_speeds(self)
        self.controller.refuse_other_tick(self.tick_s)
        _refuse_disturbances(self)
        _refuse_sensors(self)
        if self.plant.sensor.is_made or self.model.sensor.is_made:
            _refuse_made(self)
        _refuse_limits_of_the_model(self.model)
        _refuse_long_dead_times("plant", self.plant, self.tick_s)
        _refuse_long_dead_times("model", self.model, self.tick_s)

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
        """File name of the network's DBC in ``dbc/``."""
        return self.plant.linear.dbc

    @cached_property
    def healthy(self) -> Scenario:
        """A copy without faults."""
        return dataclasses.replace(self, fault=()) if self.fault else self

    @cached_property
    def noise_free(self) -> Scenario:
        """A copy without sensor noise."""
        return dataclasses.replace(self, plant=self.plant.noise_free)

    @cached_property
    def undisturbed(self) -> Scenario:
        """An equal copy for all runs that differ only in faults and sensor noise."""
        if self.fault:
            return self.healthy.undisturbed
        gusty = any(each.kind == "turbulence" for each in self.disturbances)
        return dataclasses.replace(
            self, plant=self.plant.noise_free, seed=self.seed if gusty else 0
        )

    @cached_property
    def faults(self) -> tuple[FaultSettings, ...]:
        """The effective faults, in the order of their action."""
        return tuple(fault for fault in self.fault if fault.kind != "none")

    @cached_property
    def outages(self) -> tuple[Outage, ...]:
        """The outages of the controller; see ``fault_settings.outages``."""
        return outages(self.faults, self.tick_ns)

    @cached_property
    def disturbances(self) -> tuple[DisturbanceSettings, ...]:
        """The effective disturbances."""
        return tuple(each for each in self.disturbance if each.kind != "none")

    @property
    def spells(self) -> tuple[Spell, ...]:
        """The effective faults, then the effective disturbances."""
        return (*self.faults, *self.disturbances)

    @cached_property
    def sensors(self) -> tuple[FurtherSensor, ...]:
        """The further sensors in the order of their frames, whatever their order in the file."""
        return tuple(sorted(self.sensor, key=lambda each: MEASURED.index(each.measures)))

    @cached_property
    def heard(self) -> tuple[Measured, ...]:
        """What the rig's own law hears beside reference and D*, in the order of ``HEARD``.

        Yaw rate and lateral acceleration count only together, and only of a car.
        """
        found = {each.measures for each in self.sensor}
        found -= set() if self.plant.is_car else set(MEASURED) - set(ECHOES)
        witness = {YAW_RATE, LATERAL_ACCELERATION}
        return tuple(
            each for each in HEARD if each in found and (each in ECHOES or witness <= found)
        )

    @property
    def own_code(self) -> list[str]:
        """The kinds of the controller and the plant that name code of the user's."""
        return [each.kind for each in (self.controller, self.plant) if each.is_own]

    @cached_property
    def places(self) -> tuple[str, ...]:
        """The senders of frames that can fail: ``PLACES``, then the further sensors."""
        return (*PLACES, *(each.measures for each in self.sensors))

    @property
    def loss(self) -> FaultSettings:
        """The loss to prepare for: the first fault of a channel, otherwise a default loss."""
        first = (
            self.fault[0] if self.fault and self.fault[0].channel in CHANNELS else FaultSettings()
        )
        return next((fault for fault in self.faults if fault.loses_a_channel), first)

    @property
    def notes(self) -> list[str]:
        """Notes on allowed but perhaps unintended settings, a line each."""
        others = "; for ".join(_other_plant(self))
        designed = [f"designed for {others}"] * bool(others)
        return [f"note: {line}" for line in (*designed, *self.never)]

    @property
    def never(self) -> list[str]:
        """The faults and disturbances after the end of the run, a line each."""
        return [
            f"the {each.noun} ({each.kind} at {each.at_s:g} s) never occurs: "
            f"the run ends at {self.ticks * self.tick_s:g} s"
            for each in self.spells
            if each.span_ns[0] >= self.ticks * self.tick_ns
        ]

    def as_dict(self) -> dict[str, Any]:
        """Every key and value in the form of a scenario file: a list of one is a table."""
        values = dataclasses.asdict(self)
        for key in LISTS:
            values[key] = values[key][0] if len(values[key]) == 1 else list(values[key])
        return values


def _other_plant(scenario: Scenario) -> Iterator[str]:
    """Each number of the model beside the plant's, where both differ."""
    plant, model = scenario.plant, scenario.model
    for key in (
        "variant",
        *NUMBERS,
        *(each.name for each in dataclasses.fields(VehicleParameters)),
    ):
        believed, true = getattr(model, key), getattr(plant, key)
        if believed == true or (key == "speed_mps" and scenario.drive.is_given):
            continue
        if key == "speed_mps":
            yield f"{believed:g} m/s, driven at {true:g} m/s"
        elif isinstance(true, float):
            yield f"{key} = {believed:g}, driven with {true:g}"
        else:
            yield f"model.{key}, driven with another plant.{key}"


def leaves(scenario: Scenario) -> dict[str, Any]:
    """Each key, with dots and numbers of a list's tables, and its value."""
    values = scenario.as_dict()
    for key in LISTS:
        if isinstance(values[key], list):
            values[key] = dict(enumerate(values[key]))
    return dict(flat(values))


def keys(table: type = Scenario, prefix: str = "") -> list[str]:
    """Every key that a scenario file or ``--set`` may name, with dots between table and key."""
    found: list[str] = []
    for name, kind in get_type_hints(table).items():
        inner = table_of(kind)
        if inner is not None:
            found += keys(inner, f"{prefix}{name}.")
        elif prefix or name != "name":
            found.append(prefix + name)
    return found


def table_of(kind: Any) -> type | None:
    """The settings in the type of a key: of a table or None, a list, or tables by free names."""
    if get_origin(kind) is dict:
        return table_of(get_args(kind)[1])
    inner = (each for each in (kind, *get_args(kind)) if isinstance(each, type))
    return next(filter(dataclasses.is_dataclass, inner), None)


def _refuse_speeds(scenario: Scenario) -> None:
    """Require the linear car, whose frames carry the speed, for drives and several speeds."""
    speeds = scenario.design.speeds_mps
    if not scenario.drive.is_given:
        if speeds and not scenario.network.signals.speed:
            raise ValueError(
                "design.speeds_mps: must not be set without a drive; the design is for "
                "model.speed_mps"
            )
        return
    for table, plant in (("plant", scenario.plant), ("model", scenario.model)):
        if plant.kind != CAR:
            raise ValueError(
                f"drive: {table}.kind = {plant.kind!r}: must be {CAR}, the car that has a speed"
            )
    if scenario.network.signals.of_frames:
        raise ValueError(
            "drive: network.signals: must not be set; the speed has a message in the rig's own "
            "frames only"
        )
    for before, after in itertools.pairwise(speeds or ()):
        if not after > before:
            raise ValueError(f"design.speeds_mps: {after:g} after {before:g}: must increase")


def _refuse_disturbances(scenario: Scenario) -> None:
    """Refuse what pushes another plant: a car has sides and a road, any other plant ``PUSH``."""
    plant = scenario.plant
    for each in scenario.disturbances:
        if (each.kind == PUSH) == plant.is_car:
            of_cars = ", ".join(kind for kind in NEEDED if kind != PUSH)
            right = of_cars if plant.is_car else PUSH
            raise ValueError(
                f"disturbance.kind = {each.kind!r}: must be {right} for plant.kind = {plant.kind!r}"
            )
        key = PUSHED_BY.get(plant.kind)
        if key and not getattr(plant, key):
            raise ValueError(
                f"plant.{key}: must be set for a disturbance of plant.kind = {plant.kind!r}: how "
                "the world pushes"
            )


def _refuse_sensors(scenario: Scenario) -> None:
    """Refuse two sensors of one quantity, times between ticks, and quantities of another plant.

    Refuse faults of sensors that the scenario lacks, too.
    """
    there = [each.measures for each in scenario.sensor]
    for fault in scenario.faults:
        for key, name in (("channel", fault.channel), ("other", fault.other)):
            if name in MEASURED and name not in there:
                raise ValueError(
                    f"fault.{key} = {name!r}: must be a sensor of the scenario; it has "
                    f"{', '.join(there) or 'none'}"
                )
    signals = scenario.network.signals
    for sensor in scenario.sensors if signals.of_frames else ():
        if not getattr(signals, sensor.role):
            raise ValueError(
                f"network.signals.{sensor.role}: must be set for the sensor {sensor.measures!r}"
            )
    seen: set[str] = set()
    for number, sensor in enumerate(scenario.sensor):
        where = "sensor" if len(scenario.sensor) == 1 else f"sensor.{number}"
        if sensor.measures in seen:
            raise ValueError(
                f"{where}.measures = {sensor.measures!r}: must be another; the scenario has this "
                "sensor already"
            )
        seen.add(sensor.measures)
        is_output = scenario.plant.kind == STATE_SPACE and sensor.measures not in ECHOES
        if scenario.plant.kind == TRANSFER_FUNCTIONS and sensor.measures not in ECHOES:
            raise ValueError(
                f"{where}.measures = {sensor.measures!r}: must be {' or '.join(ECHOES)}; a plant "
                f"with further outputs needs plant.kind = {STATE_SPACE!r}"
            )
        states = len(scenario.plant.a or ())
        if is_output and len(sensor.c or ()) != states:
            raise ValueError(f"{where}.c: must have {states} numbers, as many as plant.a has rows")
        if sensor.c is not None and not is_output:
            raise ValueError(
                f"{where}.c: must be left out; only a further output of plant.kind = "
                f"{STATE_SPACE!r} has it"
            )
        if sensor.signal and not scenario.plant.is_own:
            raise ValueError(
                f"{where}.signal = {sensor.signal!r}: must be left out; only a class or an FMU "
                "reports signals by names of its own"
            )
        try:
            sensor.refuse_times(scenario.tick_s)
        except ValueError as error:
            raise ValueError(f"{where}.{error}") from None


def made_noise(car: PlantSettings, sensors: tuple[FurtherSensor, ...]) -> tuple[float, float]:
    """Rms of the noise, and the step, of d a + (1 - d) V γ (3.8), m/s²; of both ``sensors``."""
    found = {each.measures: each for each in sensors}
    turning, lateral = found[YAW_RATE], found[LATERAL_ACCELERATION]
    factors = (1.0 - car.lateral_weight) * car.speed_mps, car.lateral_weight
    return (
        math.hypot(factors[0] * turning.noise_rms, factors[1] * lateral.noise_rms),
        math.hypot(factors[0] * turning.step, factors[1] * lateral.step),
    )


def _refuse_made(scenario: Scenario) -> None:
    """Refuse what a D* made of two sensors cannot be, and a ``plant.sensor`` of other numbers."""
    key, found = "plant.sensor.is_made", {each.measures: each for each in scenario.sensor}
    turning, lateral = found.get(YAW_RATE), found.get(LATERAL_ACCELERATION)
    if scenario.model.sensor.is_made != scenario.plant.sensor.is_made:
        raise ValueError("model.sensor.is_made: must be left to plant.sensor.is_made")
    if not scenario.plant.is_car or turning is None or lateral is None:
        raise ValueError(
            f"{key}: must be false without the sensors {YAW_RATE!r} and {LATERAL_ACCELERATION!r} "
            "of a car"
        )
    if scenario.controller.is_ours and scenario.design.supervision == "none":
        raise ValueError(f"{key}: must be false for design.supervision = 'none'")
    timing = turning.timing(scenario.tick_s)
    if timing[:2] != (1, 0) or timing != lateral.timing(scenario.tick_s):
        raise ValueError(
            f"{key}: must be false, or both sensors have period_s = {scenario.tick_s:g}, a tick, "
            "and the same delay_s"
        )
    if turning.lag_s != lateral.lag_s:
        raise ValueError(f"{key}: must be false, or both sensors have the same corner_hz")
    if any(fault.place == SENSOR for fault in scenario.faults):
        raise ValueError(f"fault: must be of {YAW_RATE!r} or {LATERAL_ACCELERATION!r}: {key}")
    corner_hz = 1.0 / (2.0 * math.pi * lateral.lag_s) if lateral.lag_s else None
    own = scenario.plant.sensor
    for name, given, right in (
        ("corner_hz", own.corner_hz, corner_hz),
        ("dead_time_s", own.dead_time_s, lateral.delay_s),
    ):
        if abs((given or 0.0) - (right or 0.0)) > 1e-3 * (right or 0.0):
            raise ValueError(
                f"plant.sensor.{name}: must be {right or 0:.4g}, as both sensors make D*"
            )


def _refuse_limits_of_the_model(model: PlantSettings) -> None:
    """Refuse limits in ``model``: the controller's limits belong in ``limits`` only."""
    for actuator, key, instead in (
        ("torque_actuator", "limit_nm", "torque_nm"),
        ("torque_actuator", "rate_nm_per_s", "torque_rate_nm_per_s"),
        ("force_difference_actuator", "limit_n", "force_difference_n"),
        ("force_difference_actuator", "rate_n_per_s", "force_difference_rate_n_per_s"),
    ):
        value = getattr(getattr(model, actuator), key)
        if value is not None:
            raise ValueError(
                f"model.{actuator}.{key} = {value:g}: must be limits.{instead}, the controller's "
                "belief about the actuator"
            )


def _refuse_long_dead_times(table: str, plant: PlantSettings, tick_s: float) -> None:
    """Refuse dead times, of a channel plus the sensor, too long for the controller's model."""
    sensor_s, longest_s = plant.sensor.dead_time_s, MAX_LATENCY_TICKS * tick_s
    for key, dead_time_s, beside_s in (
        ("sensor", sensor_s, 0.0),
        ("torque_actuator", plant.torque_actuator.dead_time_s, sensor_s),
        ("force_difference_actuator", plant.force_difference_actuator.dead_time_s, sensor_s),
    ):
        if dead_time_s + beside_s > longest_s * (1.0 + 1e-9):
            beside = f" beside {table}.sensor.dead_time_s = {beside_s:g}" if beside_s else ""
            raise ValueError(
                f"{table}.{key}.dead_time_s = {dead_time_s:g}: must be at most "
                f"{longest_s - beside_s:g} s{beside}, {MAX_LATENCY_TICKS} ticks in all"
            )
