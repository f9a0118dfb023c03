"""The plant of a scenario: the built-in kinds in one table, and what parameters a car may have."""

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
from firmware_model.design import plants
from firmware_model.design.actuator_dynamics import Stage
from firmware_model.design.vehicle import TABLE_3_2, Variant, VehicleParameters


@dataclass(frozen=True)
class BuiltIn:
    """A linear plant that comes with the package, and what follows from which one it is."""

    make: Callable[[VehicleParameters, Variant], plants.Plant]
    dbc: str
    """File name of its frames in ``dbc/``."""
    closed_loop: bool
    """Whether the thesis closes a loop around it, with a C that follows the reference."""
    is_car: bool
    """Whether the parameters, and a lateral acceleration, mean anything."""


BUILT_IN: Final = {
    "steer-by-wire": BuiltIn(plants.steer_by_wire, "steer_by_wire.dbc", True, True),
    "chapter-2": BuiltIn(lambda _, __: plants.chapter_2(), "chapter_2.dbc", False, False),
}
"""The plants of the thesis, by ``kind``."""

CAR: Final = "steer-by-wire"
"""What the controller believes in where the plant is a class: the car with its parameters."""


@validated(frozen=True, config=STRICT)
class PlantSettings(VehicleParameters):
    """The simulated plant; for a plant that is no car its parameters mean nothing.

    ``kind`` is built in or ``package.module:Class``, a plant of one's own (``plant.protocol``).
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
    def closed_loop(self) -> bool:
        """Whether a controller C follows the reference with it; see ``BuiltIn``."""
        return self.linear.closed_loop

    @property
    def is_car(self) -> bool:
        """Whether its parameters are those of a car; see ``BuiltIn``."""
        return self.linear.is_car

    @property
    def stages(self) -> tuple[Stage, Stage, Stage]:
        """The linear parts of both actuators and of the sensor."""
        return self.torque_actuator.stage, self.force_difference_actuator.stage, self.sensor.stage
