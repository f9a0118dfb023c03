"""The plant of a scenario: a table of the built-in kinds, and each kind's keys."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Final, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass as validated

from can_rig.scenario.stage_settings import (
    STRICT,
    ForceDifferenceActuator,
    SensorSettings,
    TorqueActuator,
)
from can_rig.scenario.tables.numbers import (
    Row,
    SignalSettings,
    TransferFunction,
    refuse_large,
)
from firmware_model.design import plants
from firmware_model.design.actuator_dynamics import Stage
from firmware_model.design.vehicle import TABLE_3_2, VehicleParameters


@dataclass(frozen=True)
class BuiltIn:
    """A kind of linear plant, and the kind's properties."""

    make: Callable[[PlantSettings], plants.Plant]
    dbc: str
    """File name of the plant's frames in ``dbc/``."""
    keys: tuple[str, ...]
    """Required keys that only this kind has."""


def _by_transfer_functions(settings: PlantSettings) -> plants.Plant:
    g1, g2 = settings.g1.factored, settings.g2.factored
    return plants.Plant.from_transfer_functions(settings.kind, g1, g2)


def _by_state_space(settings: PlantSettings) -> plants.Plant:
    a, b, c = settings.a or (), settings.b or (), settings.c or ()
    return plants.Plant.from_state_space(settings.kind, a, b, [c])


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
OWN: Final = ("parameters", "variables", "fmi_type")
"""Keys of a plant of one's own that its model lacks."""
SIGNALS: Final = ("input_1", "input_2", "output")
"""Keys for the names of the plant's signals."""


@validated(frozen=True, config=STRICT)
class PlantSettings(VehicleParameters):
    """The simulated plant; a plant by numbers must leave the car's parameters unset.

    ``kind`` is built in or a plant of one's own: ``package.module:Class`` (``plant.protocol``) or
    ``fmu:FILE.fmu`` (``plant.fmu``). ``a`` (n, n), ``b`` (n, 2) and ``c`` (n,) belong to
    ``state-space``, ``g1`` and ``g2`` to ``transfer-functions``; input 1 is the channel that can
    fail. For a plant of one's own these keys give the representing linear plant; the default is the
    car. ``friction`` μ limits a tire's force, as a share of the tire's load: linear cars ignore μ,
    a nonlinear car saturates. The bounds admit any vehicle on wheels. ``parameters`` belong to a
    plant of one's own: numbers, text, true or false. ``variables`` of an FMU: its inputs and output
    by role, and further recorded variables by column name.
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
    g1: TransferFunction = dataclasses.field(default_factory=TransferFunction)
    g2: TransferFunction = dataclasses.field(default_factory=TransferFunction)
    a: tuple[Row, ...] | None = None
    b: tuple[Row, ...] | None = None
    c: Row | None = None
    input_1: SignalSettings = dataclasses.field(default_factory=SignalSettings)
    input_2: SignalSettings = dataclasses.field(default_factory=SignalSettings)
    output: SignalSettings = dataclasses.field(default_factory=SignalSettings)
    friction: Annotated[float, Field(gt=0.0, le=10.0)] = 0.9
    torque_actuator: TorqueActuator = dataclasses.field(default_factory=TorqueActuator)
    force_difference_actuator: ForceDifferenceActuator = dataclasses.field(
        default_factory=ForceDifferenceActuator
    )
    sensor: SensorSettings = dataclasses.field(default_factory=SensorSettings)
    parameters: dict[str, Any] = dataclasses.field(default_factory=dict)
    variables: dict[str, str] = dataclasses.field(default_factory=dict)
    fmi_type: Literal["co-simulation", "model-exchange"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in BUILT_IN and not self.is_own:
            raise ValueError(
                f"kind = {self.kind!r}: must be {', '.join(BUILT_IN)}, {FMU}FILE.fmu or "
                "package.module:Class"
            )
        self._refuse_other_keys()
        _refuse_shapes(self.a or (), self.b or (), self.c or ())
        self._refuse_other_parameters()

    def _refuse_other_parameters(self) -> None:
        """Refuse parameters and variables for built-in plants, and invalid values."""
        for key, value in flat_parameters(self.parameters).items():
            if not isinstance(value, bool | int | float | str):
                raise ValueError(
                    f"parameters.{key} = {value!r}: must be a number, a text, true or false"
                )
            if not self.is_own:
                raise ValueError(
                    f"parameters.{key} = {value!r}: must not be set for kind = {self.kind!r}; only "
                    f"a plant of one's own, package.module:Class or {FMU}FILE.fmu, has parameters "
                    "of its own"
                )
        for key in ("variables", "fmi_type"):
            if getattr(self, key) and not self.is_fmu:
                raise ValueError(
                    f"{key}: must not be set for kind = {self.kind!r}; only {FMU}FILE.fmu has it"
                )
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
                raise ValueError(
                    f"{key}: must not be set{beside} for kind = {self.kind!r}; "
                    f"kind = {has!r} has it"
                )
            if key in own and not given:
                raise ValueError(
                    f"{key}: must be set for kind = {self.kind!r}, which has {', '.join(own)}"
                )
        for field in dataclasses.fields(VehicleParameters) if self.kind in BY_NUMBERS else ():
            value = getattr(self, field.name)
            if value != getattr(TABLE_3_2, field.name):
                raise ValueError(
                    f"{field.name} = {value:g}: must not be set for kind = {self.kind!r}; "
                    f"kind = {CAR!r} has it"
                )
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
        """Whether ``kind`` reads ``package.module:Class``; the class need not exist."""
        module, _, name = self.kind.partition(":")
        parts = (name, *module.split("."))
        return all(part.isidentifier() for part in parts) and not self.is_fmu

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


def flat_parameters(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """``{"body": {"mass": 5}}`` → ``{"body.mass": 5}``: tables of TOML, names of Modelica's."""
    flat: dict[str, Any] = {}
    for key, value in parameters.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{inner}": each for inner, each in flat_parameters(value).items()}
        else:
            flat[key] = value
    return flat


def _refuse_shapes(a: tuple[Row, ...], b: tuple[Row, ...], c: Row) -> None:
    """Refuse matrices other than (n, n), (n, 2) and (n,), and numbers beyond the floats."""
    n = len(a)
    if b and len(b) != n:
        raise ValueError(f"b: has {len(b)} rows: must have {n}, as many as a")
    if c and len(c) != n:
        raise ValueError(f"c: has length {len(c)}: must have {n}, as many as a has rows")
    for key, matrix, width in (("a", a, n), ("b", b, INPUTS)):
        for at, row in enumerate(matrix):
            if len(row) != width:
                raise ValueError(f"{key}[{at}]: has length {len(row)}: must have {width}")
            refuse_large(f"{key}[{at}]", row)
    refuse_large("c", c)
