"""A controller for a car whose speed changes: constants blended between designs at several speeds.

**Coefficients.** Between two neighbouring designs each coefficient is a straight line over 1/V; the
car's matrices are polynomials in 1/V. Every filter has the same poles in the same section at all
speeds (``discretisation.paired``), so that a coefficient has one meaning.

**States.** The meaning of a section's memory changes with the speed: the accumulators are s = T(V)
x, with x the state of the car (side slip, yaw rate, steering) and the actuator. The car's state
does not jump when its speed changes, so s turns with T. Over the interval between two designs

    ds/dλ = L s,   L = log(T_after T_before⁻¹),   λ = 0..1 the share of the way from one to the next

and a change of λ turns s by 1 + Δλ L + (Δλ L)²/2. So every model of the car (F1, loss model,
candidate of the test, other cars, shortfalls) keeps its motion, and braking alone causes no d̂ in a
healthy car.

``controller.step`` does not know the schedule: this module blends the table before ``step``, in a
tick with a new speed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import MAX_SECTIONS, FloatArray, Records, Struct
from firmware_model.law.supervision.covariance import MAX_DIRECTIONS
from firmware_model.law.supervision.echoes import FORCE, TORQUE
from firmware_model.law.supervision.overflow import is_damaged
from firmware_model.law.supervision.signatures import THROUGH_G1, THROUGH_G2

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.core import biquad, shortfall, thesis
    from firmware_model.law.layout import Supervision, Table
    from firmware_model.law.supervision import standby


MAX_SPEEDS = 16
CARRIED = 4  # sections of a model whose state turns: actuator, car and sensor of order 8
SIZE = 2 * CARRIED
FILTER = (MAX_SPEEDS, MAX_SECTIONS * 5)
TURN = (MAX_SPEEDS, SIZE * SIZE)
GAIN = (MAX_SPEEDS, MAX_SECTIONS * 2)
EACH = (MAX_SPEEDS,)
BAND = 0.95  # a car at the lowest speed does not alternate between standby and run
OF_G1, OF_G2 = THROUGH_G1, THROUGH_G2
OF_TORQUE, OF_FORCE = TORQUE, FORCE


class Models(Struct):
    """The models of a car."""

    channel_1: Annotated[FloatArray, "y/u1", "G1 at each speed", FILTER]
    channel_2: Annotated[FloatArray, "y/u2", "G2 at each", FILTER]
    turn_1: Annotated[FloatArray, "1", "L of G1 from each speed to the next, row by row", TURN]
    turn_2: Annotated[FloatArray, "1", "L of G2", TURN]


class Constants(Struct):
    """Constants."""

    n: Annotated[int, "1", "number of speeds", (1, MAX_SPEEDS)]
    speed: Annotated[FloatArray, "m/s", "of each design, ascending", EACH]
    tracking: Annotated[FloatArray, "u1/y", "Q at each", FILTER]
    tracking_inverse: Annotated[FloatArray, "1", "loop_inverse of C at each", EACH]
    model: Annotated[Models, "1", "the model of the car"]
    feedthrough_2: Annotated[FloatArray, "y/u2", "of G2 at each", EACH]
    compensator: Annotated[FloatArray, "u2/y", "F̂ at each", FILTER]
    compensator_feedthrough: Annotated[FloatArray, "u2/y", "of F̂ at each", EACH]
    compensator_inverse: Annotated[FloatArray, "1", "loop_inverse of F̂ at each", EACH]
    make_up_1: Annotated[FloatArray, "u1/y", "gain of the shortfall of channel 1 at each", GAIN]
    make_up_2: Annotated[FloatArray, "u2/y", "gain of the shortfall of channel 2 at each", GAIN]
    cars: Annotated[Records[Models], "1", "likewise each other car", (MAX_DIRECTIONS,)]


class State(Struct):
    """State."""

    place: Annotated[float, "1", "of the speed: the number of the design below it, and λ"]
    turned: Annotated[FloatArray, "1", "L s of one filter", (SIZE,)]
    again: Annotated[FloatArray, "1", "L L s", (SIZE,)]


@firmware
def change_speed(
    schedule: Constants, own: State, table: Table, state: layout.State, speed: float
) -> None:
    """Blend ``table`` for ``speed`` and carry the states of the models over.

    A speed beyond the designs counts as the nearest design's speed, and below the lowest design the
    controller stands by; a speed that is not a number changes no value.

    Args:
        schedule: constants of this module.
        own: state of this module; changed in place.
        table: that of the controller; changed in place.
        state: that of the controller; changed in place.
        speed: of the car, m/s.
    """
    v = real(speed, own.place)
    if not math.isfinite(v):
        return
    supervision = state.supervision
    note_speed(supervision.standby, v, schedule.speed[0])
    if table.witness.longest > 0:
        table.witness.speed = v
    place = place_of(schedule, v)
    if place == own.place or is_damaged(
        state.estimator, supervision.echoes, supervision.witness, supervision.mismatch
    ):
        return
    move(schedule, own, table, state, supervision, place)
    own.place = place
    at = int(place)
    blend(schedule, table, at, place - real(at, place))


@firmware
def note_speed(own: standby.State, speed: float, lowest: float) -> None:
    """Find out whether a car of this ``speed`` is slower than the ``lowest`` design, m/s."""
    enters = real(BAND, lowest) * lowest
    if speed < enters or (own.slow > 0 and speed < lowest):
        own.slow = 1
    else:
        own.slow = 0


@firmware
def change_first_speed(
    schedules: Records[Constants],
    owns: Records[State],
    tables: Records[Table],
    states: Records[layout.State],
    speed: float,
) -> None:
    """``change_speed`` for the first of the controllers; see ``controller.step_first``."""
    change_speed(schedules[0], owns[0], tables[0], states[0], speed)


@firmware
def place_of(schedule: Constants, speed: float) -> float:
    """The number of the design below ``speed``, and the share of the way from there to the next."""
    zero, one = real(0.0, speed), real(1.0, speed)
    place = zero
    for i in range(schedule.n - 1):
        low, high = schedule.speed[i], schedule.speed[i + 1]
        if speed > low:  # 1/V goes from 1/low to 1/high
            share = max(zero, min(one, (speed - low) / (high - low) * (high / speed)))
            place = real(i, speed) + share
    return place


@firmware
def move(
    schedule: Constants,
    own: State,
    table: Table,
    core: thesis.State,
    supervision: Supervision,
    place: float,
) -> None:
    """Turn all states from ``own.place`` to ``place``, interval by interval."""
    last = schedule.n - 2
    for k in range(schedule.n - 1):
        i = k
        if place < own.place:
            i = max(last - k, 0)
        low = real(i, place)
        high = low + real(1.0, place)
        end = min(max(place, low), high)
        begin = min(max(own.place, low), high)
        if end != begin:
            turn_models(schedule, own, table, core, supervision, i, end - begin)


@firmware
def turn_models(
    schedule: Constants,
    own: State,
    table: Table,
    core: thesis.State,
    supervision: Supervision,
    at: int,
    way: float,
) -> None:
    """Turn every state of a model of the car by ``way`` within the interval ``at``."""
    test, loss, heard = supervision.sequential_test, supervision.loss_model, supervision.echoes
    turn(schedule.model.turn_1, own, core.estimator.channel_1, at, way)
    turn(schedule.model.turn_2, own, core.estimator.channel_2, at, way)
    turn(schedule.model.turn_1, own, core.shortfall_1, at, way)
    turn(schedule.model.turn_2, own, core.shortfall_2, at, way)
    turn(schedule.model.turn_1, own, test.channel_1, at, way)
    turn(schedule.model.turn_1, own, test.earlier, at, way)
    turn(schedule.model.turn_1, own, loss.channel_1, at, way)
    turn(schedule.model.turn_1, own, loss.earlier, at, way)
    turn(schedule.model.turn_1, own, loss.fading, at, way)
    if table.echoes.longest > 0:
        turn(schedule.model.turn_1, own, heard.actuators[OF_TORQUE].known, at, way)
        turn(schedule.model.turn_2, own, heard.actuators[OF_FORCE].known, at, way)
    signatures = table.hypotheses.signatures
    for i in range(signatures.n):
        row, one = signatures.rows[i], supervision.hypotheses.signatures.rows[i]
        if row.through == OF_G1:
            turn(schedule.model.turn_1, own, one.answer, at, way)
        elif row.through == OF_G2:
            turn(schedule.model.turn_2, own, one.answer, at, way)
    cars, others = supervision.other_cars, table.other_cars.n
    if others > 0:
        turn(schedule.model.turn_1, own, cars.model.channel_1, at, way)
        turn(schedule.model.turn_2, own, cars.model.channel_2, at, way)
    for i in range(others):
        turn(schedule.cars[i].turn_1, own, cars.cars[i].channel_1, at, way)
        turn(schedule.cars[i].turn_2, own, cars.cars[i].channel_2, at, way)


@firmware
def turn(turns: FloatArray, own: State, filter_state: biquad.State, at: int, way: float) -> None:
    """s → s + way L s + (way L)² s/2 of one filter.

    Args:
        turns: L of each interval, shape ``TURN``.
        own: state of this module, for intermediate results.
        filter_state: the filter's; changed in place.
        at: the interval.
        way: Δλ.
    """
    s = filter_state.accumulators
    half = real(0.5, way)
    for row in range(SIZE):
        total = real(0.0, way)
        for m in range(CARRIED):
            total += turns[at, SIZE * row + 2 * m] * s[m, 0]
            total += turns[at, SIZE * row + 2 * m + 1] * s[m, 1]
        own.turned[row] = total * way
    for row in range(SIZE):
        total = real(0.0, way)
        for column in range(SIZE):
            total += turns[at, SIZE * row + column] * own.turned[column]
        own.again[row] = total * way * half
    for m in range(CARRIED):
        s[m, 0] += own.turned[2 * m] + own.again[2 * m]
        s[m, 1] += own.turned[2 * m + 1] + own.again[2 * m + 1]


@firmware
def blend(schedule: Constants, table: Table, at: int, share: float) -> None:
    """Make ``table`` that of the place ``share`` of the way from the design ``at`` to the next."""
    blend_filter(schedule.tracking, table.tracking.filter, at, share)
    blend_filter(schedule.model.channel_1, table.estimator.channel_1, at, share)
    blend_filter(schedule.model.channel_2, table.estimator.channel_2, at, share)
    blend_filter(schedule.compensator, table.compensator.filter, at, share)
    table.tracking.loop_inverse = between(schedule.tracking_inverse, at, share)
    table.estimator.feedthrough_2 = between(schedule.feedthrough_2, at, share)
    table.compensator.feedthrough = between(schedule.compensator_feedthrough, at, share)
    table.compensator.loop_inverse = between(schedule.compensator_inverse, at, share)
    blend_gain(schedule.make_up_1, table.shortfall_1, table.estimator.channel_1.n, at, share)
    blend_gain(schedule.make_up_2, table.shortfall_2, table.estimator.channel_2.n, at, share)
    cars = table.other_cars
    for i in range(MAX_DIRECTIONS):
        blend_filter(schedule.cars[i].channel_1, cars.cars[i].channel_1, at, share)
        blend_filter(schedule.cars[i].channel_2, cars.cars[i].channel_2, at, share)


@firmware
def between(values: FloatArray, at: int, share: float) -> float:
    """The value on the line from the ``at``-th of ``values`` to the next."""
    value: float = values[at]
    if share != 0.0:
        value += share * (values[min(at + 1, MAX_SPEEDS - 1)] - value)
    return value


@firmware
def blend_filter(designs: FloatArray, cascade: biquad.Constants, at: int, share: float) -> None:
    """Blend the coefficients of a cascade; ``designs`` has one row for each speed."""
    n = cascade.n
    for i in range(n):
        for j in range(5):
            value = designs[at, 5 * i + j]
            if share != 0.0:
                value += share * (designs[min(at + 1, MAX_SPEEDS - 1), 5 * i + j] - value)
            cascade.coefficients[i, j] = value


@firmware
def blend_gain(
    designs: FloatArray, shortfall: shortfall.Constants, n: int, at: int, share: float
) -> None:
    """The gain of a shortfall of ``n`` sections likewise."""
    for i in range(n):
        for j in range(2):
            value = designs[at, 2 * i + j]
            if share != 0.0:
                value += share * (designs[min(at + 1, MAX_SPEEDS - 1), 2 * i + j] - value)
            shortfall.gain[i, j] = value
