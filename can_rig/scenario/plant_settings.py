"""The plant of a scenario: the built-in kinds in one table, and the keys of each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
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
    """A kind of linear plant, and what follows from which one it is."""

    make: Callable[[PlantSettings], plants.Plant]
    dbc: str
    """File name of its frames in ``dbc/``."""
    keys: tuple[str, ...]
    """Those that only this kind has, and must have."""


def _by_transfer_functions(settings: PlantSettings) -> plants.Plant:
    g1, g2 = settings.g1.factored, settings.g2.factored
    return plants.Plant.from_transfer_functions(settings.kind, g1, g2)


def _by_state_space(settings: PlantSettings) -> plants.Plant:
    a, b, c = settings.a or (), settings.b or (), settings.c or ()
    return plants.Plant.from_state_space(settings.kind, a, b, [c])


CAR: Final = "steer-by-wire"
"""What the controller believes in where the plant is a class: the car with its parameters."""
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

NUMBERS: Final = tuple(key for kind in BUILT_IN.values() for key in kind.keys)
"""Keys that describe a plant by numbers."""
SIGNALS: Final = ("input_1", "input_2", "output")
"""Keys that say what its signals are called."""


@validated(frozen=True, config=STRICT)
class PlantSettings(VehicleParameters):
    """The simulated plant; for a plant by numbers the parameters of the car mean nothing.

    ``kind`` is built in or ``package.module:Class``, a plant of one's own (``plant.protocol``).
    ``a`` (n, n), ``b`` (n, 2) and ``c`` (n,) are those of ``state-space``, ``g1`` and ``g2`` those
    of ``transfer-functions``; input 1 is the channel that can be lost.
    ``friction`` μ is what tires can transmit at most, as a part of their load: the linear cars
    ignore it, a nonlinear one saturates with it. The bounds leave room for anything on wheels.
    ``parameters`` are those that only a plant of one's own knows: numbers, text, true or false.
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in BUILT_IN and not self.is_class:
            raise ValueError(
                f"kind = {self.kind!r}: must be {', '.join(BUILT_IN)} or package.module:Class"
            )
        self._refuse_other_keys()
        _refuse_shapes(self.a or (), self.b or (), self.c or ())
        for key, value in self.parameters.items():
            if not isinstance(value, bool | int | float | str):
                raise ValueError(
                    f"parameters.{key} = {value!r}: must be a number, a text, true or false"
                )
            if not self.is_class:
                raise ValueError(
                    f"parameters.{key} = {value!r}: must not be set for kind = {self.kind!r}; only "
                    "a plant of one's own, package.module:Class, has parameters of its own"
                )

    def _refuse_other_keys(self) -> None:
        """Every key that this kind of plant needs, and none of another kind."""
        own = () if self.is_class else BUILT_IN[self.kind].keys
        for key in NUMBERS:
            given = bool(getattr(self, key))
            if given and key not in own:
                raise ValueError(f"{key}: must not be set for kind = {self.kind!r}")
            if key in own and not given:
                raise ValueError(
                    f"{key}: must be set for kind = {self.kind!r}, which has {', '.join(own)}"
                )
        for key in SIGNALS if self.kind == CAR else ():
            if getattr(self, key) != SignalSettings():
                raise ValueError(
                    f"{key}: must not be set for kind = {self.kind!r}, whose signals have names"
                )

    @property
    def is_class(self) -> bool:
        """Whether ``kind`` reads ``package.module:Class``; not whether there is one."""
        module, _, name = self.kind.partition(":")
        return name.isidentifier() and all(part.isidentifier() for part in module.split("."))

    @property
    def linear(self) -> BuiltIn:
        """The built-in plant; of a plant that is a class, the car that stands for it."""
        return BUILT_IN[CAR if self.is_class else self.kind]

    @property
    def is_car(self) -> bool:
        """Whether the parameters, and a lateral acceleration, mean anything."""
        return self.linear is BUILT_IN[CAR]

    @property
    def stages(self) -> tuple[Stage, Stage, Stage]:
        """The linear parts of both actuators and of the sensor."""
        return self.torque_actuator.stage, self.force_difference_actuator.stage, self.sensor.stage


def _refuse_shapes(a: tuple[Row, ...], b: tuple[Row, ...], c: Row) -> None:
    """Refuse matrices that are not (n, n), (n, 2) and (n,), and numbers that leave the floats."""
    n = len(a)
    if b and len(b) != n:
        raise ValueError(f"b: has {len(b)} rows: must have {n}, as many as a")
    if c and len(c) != n:
        raise ValueError(f"c: has {len(c)} numbers: must have {n}, as many as a has rows")
    for key, matrix, width in (("a", a, n), ("b", b, INPUTS)):
        for at, row in enumerate(matrix):
            if len(row) != width:
                raise ValueError(f"{key}[{at}]: has {len(row)} numbers: must have {width}")
            refuse_large(f"{key}[{at}]", row)
    refuse_large("c", c)
