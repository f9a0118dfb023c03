"""The effect on d̂ of healthy cars that differ from the model.

    x_i = (G1_i - G1) u1 + (G2_i - G2) u2

with G1_i, G2_i the models of another car, along the i-th principal direction of the allowed box of
cars and scaled to the end of the box (``design.mismatch``). A known lost command drives no model.

For an unstable plant, in coprime factors over the same poles,

    x_i = (N1_i - N1) u1 + (N2_i - N2) u2 - (M_i - M) y
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output, settle
from firmware_model.law.structs import FloatArray, Records, Struct
from firmware_model.law.supervision.covariance import MAX_DIRECTIONS

if TYPE_CHECKING:
    from firmware_model.law.layout import Table


class Car(Struct):
    """Constants of one car."""

    channel_1: Annotated[biquad.Constants, "y/u1", "G1 of this car"]
    channel_2: Annotated[biquad.Constants, "y/u2", "G2 of this car"]
    measurement: Annotated[biquad.Constants, "1", "M of this car; no section for a stable car"]


class CarState(Struct):
    """State of one car."""

    channel_1: Annotated[biquad.State, "y", "its state"]
    channel_2: Annotated[biquad.State, "y", "its state"]
    measurement: Annotated[biquad.State, "y", "its state"]


class Constants(Struct):
    """Constants."""

    n: Annotated[int, "1", "principal directions in use", (0, MAX_DIRECTIONS)]
    scale: Annotated[float, "1", "from a car of this table to the end of the box"]
    cars: Annotated[Records[Car], "1", "the car along each direction", (MAX_DIRECTIONS,)]


class State(Struct):
    """State."""

    model: Annotated[CarState, "y", "the model, driven by the same commands"]
    cars: Annotated[Records[CarState], "y", "each car", (MAX_DIRECTIONS,)]
    shown: Annotated[FloatArray, "y", "x_i of this tick", (MAX_DIRECTIONS,)]
    command_1: Annotated[float, "u1", "command 1 in the measurement, without the known loss"]
    command_2: Annotated[float, "u2", "command 2 likewise"]


@firmware
def show_other_cars(table: Table, own: State, y: float, command_1: float, command_2: float) -> None:
    """Compute x of this tick; these commands begin to act on the measurement ``y``."""
    cars, shown = table.other_cars, own.shown
    own.command_1, own.command_2 = command_1, command_2
    if cars.n == 0:
        return
    u1, u2 = command_1, command_2
    model = output(table.estimator.channel_1, own.model.channel_1, u1)
    model += output(table.estimator.channel_2, own.model.channel_2, u2)
    if table.estimator.measurement.n > 0:
        model -= output(table.estimator.measurement, own.model.measurement, y)
    for i in range(cars.n):
        shown[i] = (car_output(cars.cars[i], own.cars[i], u1, u2, y) - model) * cars.scale


@firmware
def advance_other_cars(table: Table, own: State, y: float, command_2: float) -> None:
    """Advance every car by the commands of ``show_other_cars``, or what became of command 2."""
    cars = table.other_cars
    if table.estimator.shown_ticks_2 == 0:
        own.command_2 = command_2
    if cars.n > 0:
        advance(table.estimator.channel_1, own.model.channel_1, own.command_1)
        advance(table.estimator.channel_2, own.model.channel_2, own.command_2)
        advance(table.estimator.measurement, own.model.measurement, y)
    for i in range(cars.n):
        advance_car(cars.cars[i], own.cars[i], own.command_1, own.command_2, y)


@firmware
def settle_other_cars(
    table: Table, own: State, y: float, command_1: float, command_2: float
) -> None:
    """The steady state for constant commands and a constant measurement."""
    cars = table.other_cars
    settle(table.estimator.channel_1, own.model.channel_1, command_1)
    settle(table.estimator.channel_2, own.model.channel_2, command_2)
    settle(table.estimator.measurement, own.model.measurement, y)
    for i in range(MAX_DIRECTIONS):
        settle_car(cars.cars[i], own.cars[i], command_1, command_2, y)
    show_other_cars(table, own, y, command_1, command_2)


@firmware
def clear_other_cars(own: State) -> None:
    """Every car is at rest."""
    clear_car(own.model)
    for i in range(MAX_DIRECTIONS):
        clear_car(own.cars[i])
    own.shown[:] = 0.0
    own.command_1 = own.command_2 = 0.0


@firmware
def car_output(car: Car, state: CarState, u1: float, u2: float, y: float) -> float:
    """What a car explains of ``y``: G1 u1 + G2 u2, or N1 u1 + N2 u2 less M y."""
    explained: float = output(car.channel_1, state.channel_1, u1)
    explained += output(car.channel_2, state.channel_2, u2)
    if car.measurement.n > 0:
        explained -= output(car.measurement, state.measurement, y)
    return explained


@firmware
def advance_car(car: Car, state: CarState, u1: float, u2: float, y: float) -> None:
    """A tick on."""
    advance(car.channel_1, state.channel_1, u1)
    advance(car.channel_2, state.channel_2, u2)
    advance(car.measurement, state.measurement, y)


@firmware
def settle_car(car: Car, state: CarState, u1: float, u2: float, y: float) -> None:
    """Its steady state."""
    settle(car.channel_1, state.channel_1, u1)
    settle(car.channel_2, state.channel_2, u2)
    settle(car.measurement, state.measurement, y)


@firmware
def clear_car(state: CarState) -> None:
    """At rest."""
    state.channel_1.accumulators[:] = 0.0
    state.channel_2.accumulators[:] = 0.0
    state.measurement.accumulators[:] = 0.0
