"""The keys of a plant: its stages, its numbers, and a table of the built-in kinds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, PositiveFloat
from pydantic.dataclasses import dataclass

from can_rig.scenario.own_class import is_class_path
from firmware_model.design import plants
from firmware_model.design.actuator_dynamics import Stage
from firmware_model.design.vehicle import TABLE_3_2, VehicleParameters
from firmware_model.design.zpk import Roots, ZeroPoleGain

STRICT: Final = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
"""Refuse unknown keys, text for numbers, and non-finite numbers."""

SHORTEST_LAG_S = 1e-6  # no tick could show a shorter lag

Lag = Annotated[float, Field(ge=0.0, le=10.0)]
DeadTime = Annotated[float, Field(ge=0.0, le=100.0)]


@dataclass(frozen=True, config=STRICT)
class ActuatorLag:
    """A lag of first order, ``lag_s``, or of second order, after a dead time."""

    lag_s: Lag = 0.0
    natural_frequency_rad_per_s: Annotated[float, Field(ge=0.01, le=1e6)] | None = None
    damping: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0
    dead_time_s: DeadTime = 0.0

    def __post_init__(self) -> None:
        if 0.0 < self.lag_s < SHORTEST_LAG_S:
            raise ValueError(
                f"lag_s = {self.lag_s:g}: must be 0 (none) or at least {SHORTEST_LAG_S:g} s"
            )
        if self.lag_s > 0.0 and self.natural_frequency_rad_per_s is not None:
            raise ValueError(
                f"lag_s = {self.lag_s:g}: must not stand beside natural_frequency_rad_per_s = "
                f"{self.natural_frequency_rad_per_s:g}; an actuator has one or the other"
            )

    @property
    def stage(self) -> Stage:
        """The linear part of the lag."""
        return Stage(self.lag_s, self.natural_frequency_rad_per_s, self.damping, self.dead_time_s)

    @property
    def lags(self) -> bool:
        """Whether the actuator follows with a lag, apart from a dead time."""
        return self.lag_s > 0.0 or self.natural_frequency_rad_per_s is not None

    def slower(self, factor: float) -> Self:
        """A copy with every time constant multiplied by ``factor``."""
        omega = self.natural_frequency_rad_per_s
        return replace(
            self,
            lag_s=self.lag_s * factor,
            natural_frequency_rad_per_s=None if omega is None else omega / factor,
        )


@dataclass(frozen=True, config=STRICT)
class TorqueActuator(ActuatorLag):
    """The steering motor; without limits, the motor follows every sent command."""

    limit_nm: PositiveFloat | None = None
    rate_nm_per_s: PositiveFloat | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Largest magnitude and rate of the motor's output."""
        return or_infinite(self.limit_nm), or_infinite(self.rate_nm_per_s)


@dataclass(frozen=True, config=STRICT)
class ForceDifferenceActuator(ActuatorLag):
    """The rear drives; without limits, the drives follow every sent command."""

    limit_n: PositiveFloat | None = None
    rate_n_per_s: PositiveFloat | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Largest magnitude and rate of the drives' output."""
        return or_infinite(self.limit_n), or_infinite(self.rate_n_per_s)


@dataclass(frozen=True, config=STRICT)
class SensorSettings:
    """The sensor of D*: a dead time, a filter, noise and a resolution, in this order.

    The filter colours the noise; the rms describes the coloured noise. A car without this sensor
    (``is_made``) has a yaw rate and a lateral acceleration, of which the controller makes D*:
    corner and dead time are those of both, and the noise serves ``tune`` alone.
    """

    noise_mps2: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    resolution_mps2: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    corner_hz: Annotated[float, Field(ge=1e-3, le=1e5)] | None = None
    dead_time_s: DeadTime = 0.0
    is_made: bool = False

    @property
    def lag_s(self) -> float:
        """The time constant of the filter; 0: no filter."""
        return 0.0 if self.corner_hz is None else 1.0 / (2.0 * math.pi * self.corner_hz)

    @property
    def stage(self) -> Stage:
        """The linear part of the sensor."""
        return Stage(self.lag_s, dead_time_s=self.dead_time_s)


def or_infinite(limit: float | None) -> float:
    """A limit; infinite where there is none."""
    return math.inf if limit is None else limit


LARGEST = 1e100  # largest given number: products of two given numbers remain finite
PAIR = 2  # parts of a complex root
LONGEST = 40  # letters of a name
FACTORED: Final = ("zeros", "poles", "gain")
POLYNOMIAL: Final = ("num", "den")

Row = tuple[float, ...]
Root = Annotated[
    Any, AfterValidator(lambda given: tuple(given) if isinstance(given, list) else given)
]
"""A number, or a pair; ``TransferFunction`` refuses other values."""


def _only_row(given: Any) -> Any:
    """The row of a matrix with a single row, as C of a state space often stands."""
    if isinstance(given, list) and len(given) == 1 and isinstance(given[0], list):
        given = given[0]
    return tuple(given) if isinstance(given, list) else given


class Table(dict[str, Any]):
    """Free keys within hashable settings; nobody changes the table. 1, 1.0 and true differ."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(repr(self))


@dataclass(frozen=True, config=STRICT)
class TransferFunction:
    """``num`` and ``den``, highest power first, or ``zeros``, ``poles`` [rad/s] and ``gain``.

    A root is a number, or ``[real, imaginary]`` for a pair of conjugates. The gain is k in k Π(s -
    zero) / Π(s - pole).
    """

    num: Row | None = None
    den: Row | None = None
    zeros: tuple[Root, ...] | None = None
    poles: tuple[Root, ...] | None = None
    gain: float | None = None

    def __post_init__(self) -> None:
        for key in ("num", "den"):
            refuse_large(key, getattr(self, key) or ())
        for key in ("zeros", "poles"):
            for at, root in enumerate(getattr(self, key) or ()):
                _refuse_root(f"{key}[{at}]", root)
        refuse_large("gain", () if self.gain is None else (self.gain,))
        polynomial, factored = self._given(POLYNOMIAL), self._given(FACTORED)
        if polynomial and factored:
            raise ValueError(
                f"{factored[0]}: must not stand beside {polynomial[0]}; a transfer function is "
                "num and den, or zeros, poles and gain"
            )
        for form, given in ((POLYNOMIAL, polynomial), (("poles", "gain"), factored)):
            for key in form if given else ():
                if getattr(self, key) is None:
                    raise ValueError(f"{key}: must be given beside {given[0]}")
        if self.den is not None and not any(self.den):
            raise ValueError(f"den = {list(self.den)}: must have a coefficient other than 0")

    def __bool__(self) -> bool:
        """Whether any key is given."""
        return bool(self._given((*POLYNOMIAL, *FACTORED)))

    def _given(self, keys: tuple[str, ...]) -> list[str]:
        return [key for key in keys if getattr(self, key) is not None]

    @property
    def factored(self) -> ZeroPoleGain:
        """The transfer function with its polynomials' roots.

        Raises:
            DesignError: coefficients with a ratio beyond the floats.
        """
        if self.num is not None and self.den is not None:
            return ZeroPoleGain.from_coefficients(self.num, self.den)
        return ZeroPoleGain(_roots(self.zeros), _roots(self.poles), self.gain or 0.0)

    def scaled(self, gain: float, speed: float) -> Self:
        """``gain`` times as strong, with poles and zeros ``speed`` times as fast: k G(s/v)."""
        if self.num is not None and self.den is not None:
            return replace(
                self, num=_faster(self.num, speed, gain), den=_faster(self.den, speed, 1.0)
            )
        poles, zeros = _roots(self.poles), _roots(self.zeros)
        power = speed ** (len(poles) - len(zeros))
        return replace(
            self,
            zeros=_moved(self.zeros, speed),
            poles=_moved(self.poles, speed),
            gain=(self.gain or 0.0) * gain * power,
        )


@dataclass(frozen=True, config=STRICT)
class SignalSettings:
    """The name of a plant's signal, and its unit; unset: the kind's default."""

    name: str | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        for key, value in (("name", self.name), ("unit", self.unit)):
            if value and not (value.isprintable() and len(value) <= LONGEST and "$" not in value):
                raise ValueError(
                    f"{key} = {value!r}: must be at most {LONGEST} printable letters, none a $"
                )
        if self.name is not None and not self.name.strip():
            raise ValueError(f"name = {self.name!r}: must be a word or more")


def refuse_large(key: str, values: Row) -> None:
    """Refuse a number whose product with another given number is infinite."""
    for value in values:
        if abs(value) > LARGEST:
            raise ValueError(f"{key} = {value:g}: must be at most {LARGEST:g} in magnitude")


def _refuse_root(key: str, root: object) -> None:
    given = list(root) if isinstance(root, tuple) else root
    parts: list[Any] = given if isinstance(given, list) else [given]
    for part in parts:
        number = isinstance(part, int | float) and not isinstance(part, bool)
        if not (number and math.isfinite(part) and abs(part) <= LARGEST and len(parts) <= PAIR):
            pair = "[real, imaginary] for a pair of conjugates"
            raise ValueError(f"{key} = {given!r}: must be a number, or {pair}")
    if len(parts) != 1 and not (len(parts) == PAIR and parts[1] > 0.0):
        raise ValueError(
            f"{key} = {given!r}: must have an imaginary part above 0, which stands for both roots"
        )


def _roots(given: tuple[Any, ...] | None) -> Roots:
    pairs = [complex(*root) for root in given or () if isinstance(root, tuple)]
    real = [complex(root) for root in given or () if not isinstance(root, tuple)]
    return (*real, *pairs, *(root.conjugate() for root in pairs))


def _moved(given: tuple[Any, ...] | None, speed: float) -> tuple[Any, ...] | None:
    if given is None:
        return None
    return tuple(
        tuple(part * speed for part in root) if isinstance(root, tuple) else root * speed
        for root in given
    )


def _faster(coefficients: Row, speed: float, gain: float) -> Row:
    powers = range(len(coefficients) - 1, -1, -1)
    return tuple(gain * c / speed**i for c, i in zip(coefficients, powers, strict=True))


@dataclasses.dataclass(frozen=True)
class BuiltIn:
    """A kind of linear plant, and the kind's properties."""

    make: Callable[[PlantSettings], plants.Plant]
    dbc: str
    """File name of the plant's frames in ``dbc/``."""
    keys: tuple[str, ...]
    """Required keys that only this kind has."""


def _by_transfer_functions(settings: PlantSettings) -> plants.Plant:
    g1, g2 = settings.g1.factored, settings.g2.factored
    gw = settings.gw.factored if settings.gw else None
    return plants.Plant.from_transfer_functions(settings.kind, g1, g2, gw)


def _by_state_space(settings: PlantSettings) -> plants.Plant:
    a, b, c = settings.a or (), settings.b or (), settings.c or ()
    world = None if settings.e is None else plants.push(settings.e)
    return plants.Plant.from_state_space(settings.kind, a, b, [c], world)


CAR: Final = "steer-by-wire"
"""The controller's model for a plant of one's own without numbers."""
FMU: Final = "fmu:"
"""Prefix of a kind that names an FMU file."""
TRANSFER_FUNCTIONS: Final = "transfer-functions"
STATE_SPACE: Final = "state-space"
INPUTS: Final = 2
BY_NUMBERS_DBC: Final = "plant_by_numbers.dbc"

BUILT_IN: Final = {
    CAR: BuiltIn(lambda s: plants.steer_by_wire(s, s.variant), "steer_by_wire.dbc", ()),
    TRANSFER_FUNCTIONS: BuiltIn(_by_transfer_functions, BY_NUMBERS_DBC, ("g1", "g2")),
    STATE_SPACE: BuiltIn(_by_state_space, BY_NUMBERS_DBC, ("a", "b", "c")),
}
"""The linear plants, by ``kind``."""

BY_NUMBERS: Final = (TRANSFER_FUNCTIONS, STATE_SPACE)
NUMBERS: Final = tuple(key for kind in BUILT_IN.values() for key in kind.keys)
"""Keys of a plant by numbers."""
PUSHED_BY: Final = {TRANSFER_FUNCTIONS: "gw", STATE_SPACE: "e"}
"""The key by which the world pushes a plant by numbers."""
OWN: Final = ("parameters", "variables", "fmi_type")
"""Keys of a plant of one's own that its model lacks."""
SIGNALS: Final = ("input_1", "input_2", "output")
"""Keys for the names of the plant's signals."""


@dataclass(frozen=True, config=STRICT)
class PlantSettings(VehicleParameters):
    """The simulated plant; a plant by numbers must leave the car's parameters unset.

    ``kind`` is built in or a plant of one's own: ``package.module:Class`` (``plant.protocol``) or
    ``fmu:FILE.fmu`` (``plant.fmu``). ``a`` (n, n), ``b`` (n, 2) and ``c`` (n,) belong to ``state-
    space``, ``g1`` and ``g2`` to ``transfer-functions``; input 1 is the channel that can fail.
    ``e`` (n,) or ``gw`` say how the world pushes such a plant: ẋ = A x + B u + E w, y = G1 u1 + G2
    u2 + Gw w. For a plant of one's own these keys give the representing linear plant; the default
    is the car. ``friction`` μ limits a tire's force, as a share of the tire's load: linear cars
    ignore μ, a nonlinear car saturates. The bounds admit any vehicle on wheels. ``parameters``
    belong to a plant of one's own: numbers, text, true or false. ``variables`` of an FMU: its
    inputs and output by role, and further recorded variables by column name.
    """

    mass_kg: Annotated[float, Field(ge=10.0, le=1e6)] = TABLE_3_2.mass_kg
    yaw_inertia_kgm2: Annotated[float, Field(ge=0.1, le=1e8)] = TABLE_3_2.yaw_inertia_kgm2
    front_axle_distance_m: Annotated[float, Field(ge=0.01, le=50.0)] = (
        TABLE_3_2.front_axle_distance_m
    )
    rear_axle_distance_m: Annotated[float, Field(ge=0.01, le=50.0)] = TABLE_3_2.rear_axle_distance_m
    rear_track_m: Annotated[float, Field(ge=0.01, le=20.0)] = TABLE_3_2.rear_track_m
    steering_inertia_kgm2: Annotated[float, Field(ge=1e-3, le=1e5)] = (
        TABLE_3_2.steering_inertia_kgm2
    )
    steering_damping_nms_per_rad: Annotated[float, Field(ge=0.0, le=1e6)] = (
        TABLE_3_2.steering_damping_nms_per_rad
    )
    front_cornering_stiffness_n_per_rad: Annotated[float, Field(ge=10.0, le=1e8)] = (
        TABLE_3_2.front_cornering_stiffness_n_per_rad
    )
    rear_cornering_stiffness_n_per_rad: Annotated[float, Field(ge=10.0, le=1e8)] = (
        TABLE_3_2.rear_cornering_stiffness_n_per_rad
    )
    trail_m: Annotated[float, Field(ge=1e-4, le=5.0)] = TABLE_3_2.trail_m
    speed_mps: Annotated[float, Field(ge=0.01, le=200.0)] = TABLE_3_2.speed_mps
    lateral_weight: Annotated[float, Field(ge=0.0, le=1.0)] = TABLE_3_2.lateral_weight
    kind: str = CAR
    variant: Literal["physics", "published"] = "physics"
    g1: TransferFunction = TransferFunction()
    g2: TransferFunction = TransferFunction()
    a: tuple[Row, ...] | None = None
    b: tuple[Row, ...] | None = None
    c: Annotated[Row, BeforeValidator(_only_row)] | None = None
    gw: TransferFunction = TransferFunction()
    e: Row | None = None
    input_1: SignalSettings = SignalSettings()
    input_2: SignalSettings = SignalSettings()
    output: SignalSettings = SignalSettings()
    friction: Annotated[float, Field(gt=0.0, le=10.0)] = 0.9
    torque_actuator: TorqueActuator = TorqueActuator()
    force_difference_actuator: ForceDifferenceActuator = ForceDifferenceActuator()
    sensor: SensorSettings = SensorSettings()
    parameters: Annotated[dict[str, Any], AfterValidator(Table)] = dataclasses.field(
        default_factory=Table
    )
    variables: Annotated[dict[str, str], AfterValidator(Table)] = dataclasses.field(
        default_factory=Table
    )
    fmi_type: Literal["co-simulation", "model-exchange"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in BUILT_IN and not self.is_own:
            raise ValueError(
                f"kind = {self.kind!r}: must be {', '.join(BUILT_IN)}, {FMU}FILE.fmu or "
                "package.module:Class"
            )
        self._refuse_other_keys()
        _refuse_shapes(self.a or (), self.b or (), {"c": self.c or (), "e": self.e or ()})
        self._refuse_other_parameters()

    def _refuse_other_parameters(self) -> None:
        """Refuse parameters and variables for built-in plants, and invalid values."""
        for key, value in checked_parameters(self.parameters):
            if not self.is_own:
                raise ValueError(
                    f"parameters.{key} = {value!r}: must not be set for kind = {self.kind!r}; only "
                    f"a plant of one's own, package.module:Class or {FMU}FILE.fmu, has parameters "
                    "of its own"
                )
        for key in ("variables", "fmi_type"):
            if getattr(self, key) and not self.is_fmu:
                raise not_of(self.kind, key, f"only {FMU}FILE.fmu")
        for key in SIGNALS if self.is_fmu else ():
            if not self.variables.get(key):
                raise ValueError(f"variables.{key}: must be set, as the name of the FMU's variable")

    def _refuse_other_keys(self) -> None:
        """Require every key of this kind of plant; refuse the keys of other kinds."""
        own = BUILT_IN[self.linear_kind].keys
        for key in NUMBERS:
            given = bool(getattr(self, key))
            if given and key not in own:
                beside = f" beside {', '.join(own)}" if own and self.is_own else ""
                has = next(kind for kind, built_in in BUILT_IN.items() if key in built_in.keys)
                raise not_of(self.kind, key, f"kind = {has!r}", beside)
            if key in own and not given:
                raise ValueError(
                    f"{key}: must be set for kind = {self.kind!r}, which has {', '.join(own)}"
                )
        for kind, key in PUSHED_BY.items():
            if getattr(self, key) and self.kind != kind:
                raise not_of(self.kind, key, f"kind = {kind!r}")
        for field in dataclasses.fields(VehicleParameters) if self.kind in BY_NUMBERS else ():
            value = getattr(self, field.name)
            if value != getattr(TABLE_3_2, field.name):
                raise not_of(self.kind, f"{field.name} = {value:g}", f"kind = {CAR!r}")
        for key in SIGNALS if self.kind == CAR else ():
            if getattr(self, key) != SignalSettings():
                raise ValueError(
                    f"{key}: must not be set for kind = {self.kind!r}, whose signals have names"
                )

    @property
    def is_own(self) -> bool:
        """Whether the plant is the user's own, unknown before the run."""
        return self.is_fmu or self.is_class

    @property
    def is_fmu(self) -> bool:
        """Whether ``kind`` reads ``fmu:FILE.fmu``; the file need not exist."""
        return self.kind.startswith(FMU) and len(self.kind) > len(FMU)

    @property
    def is_class(self) -> bool:
        """Whether ``kind`` names a class, which need not exist."""
        return is_class_path(self.kind) and not self.is_fmu

    @property
    def linear_kind(self) -> str:
        """The built-in kind; for a plant of one's own, the representing linear plant's kind."""
        if not self.is_own:
            return self.kind
        if any((self.a, self.b, self.c)):
            return STATE_SPACE
        return TRANSFER_FUNCTIONS if self.g1 or self.g2 else CAR

    @property
    def linear(self) -> BuiltIn:
        """The built-in plant; for a plant of one's own, the representing linear plant."""
        return BUILT_IN[self.linear_kind]

    @property
    def is_car(self) -> bool:
        """Whether the car's parameters, and a lateral acceleration, have a meaning."""
        return self.linear is BUILT_IN[CAR]

    @property
    def second_mass(self) -> int | None:
        """The state that is the position of a second mass; None: no such state is known.

        Of ``state-space`` with a position in m as its output: a state that is not the output, with
        a second state as its rate.
        """
        if self.kind != STATE_SPACE or self.output.unit != "m":
            return None
        of_output = [at for at, share in enumerate(self.c or ()) if share]
        rates = zip(self.a or (), self.b or (), strict=True)
        places = [
            at
            for at, (row, driven) in enumerate(rates)
            if not any(driven) and sorted(filter(None, row)) == [1.0]
        ]
        others = [at for at in places if [at] != of_output]
        return others[0] if len(of_output) == 1 and len(others) == len(places) - 1 == 1 else None

    @property
    def noun(self) -> str:
        """The plant's name in sentences."""
        return "car" if self.is_car else "plant"

    @cached_property
    def noise_free(self) -> PlantSettings:
        """A copy without sensor noise."""
        sensor = dataclasses.replace(self.sensor, noise_mps2=0.0)
        return dataclasses.replace(self, sensor=sensor) if sensor != self.sensor else self

    @property
    def stages(self) -> tuple[Stage, Stage, Stage]:
        """The linear parts of both actuators and the sensor."""
        return self.torque_actuator.stage, self.force_difference_actuator.stage, self.sensor.stage


def not_of(kind: str, key: str, has: str, beside: str = "") -> ValueError:
    """Return the refusal of a key that only another kind of plant or controller has."""
    return ValueError(f"{key}: must not be set{beside} for kind = {kind!r}; {has} has it")


def flat(values: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """``{"body": {"mass": 5}}`` → ``("body.mass", 5)``: tables of TOML, names of Modelica's."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def checked_parameters(parameters: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The flat parameters, each a finite number, a text, true or false."""
    for key, value in flat(parameters):
        if not isinstance(value, bool | int | float | str):
            raise ValueError(
                f"parameters.{key} = {value!r}: must be a number, a text, true or false"
            )
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"parameters.{key} = {value!r}: must be a finite number")
        yield key, value


def _refuse_shapes(a: tuple[Row, ...], b: tuple[Row, ...], vectors: Mapping[str, Row]) -> None:
    """Refuse matrices other than (n, n), (n, 2) and (n,), and numbers beyond the floats."""
    n = len(a)
    if b and len(b) != n:
        raise ValueError(f"b: has {len(b)} rows: must have {n}, as many as a")
    for key, vector in vectors.items():
        if vector and len(vector) != n:
            raise ValueError(
                f"{key}: has length {len(vector)}: must have {n}, as many as a has rows"
            )
        refuse_large(key, vector)
    for key, matrix, width in (("a", a, n), ("b", b, INPUTS)):
        for at, row in enumerate(matrix):
            if len(row) != width:
                raise ValueError(f"{key}[{at}]: has length {len(row)}: must have {width}")
            refuse_large(f"{key}[{at}]", row)
