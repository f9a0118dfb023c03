"""A reference within the actuator's reach: r with a limited second derivative.

C asks for the second derivative of the reference: G1 has relative degree two, so u1 = r̈/g1 and
more. No motor delivers the torque of a step, and a limit on the torque alone makes the loop brake
too late: full torque up to the step, full torque back, over and over. So where the motor has a
limit, C follows a shaped reference r_s that reaches r in minimum time with

    |r̈_s| ≤ R

by the time-optimal law of a double integrator in whole ticks (Han and Yuan 1999): the speed from
which equal decrements, one a tick, end exactly at the target, without overshoot or chatter. The
coordinates move with r: a reference within R passes unchanged, without a tick of delay. The shaper
is outside the loop, so no margin changes.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct


class Constants(Struct):
    """Constants."""

    enabled: Annotated[int, "1", "1: C follows the shaped reference r_s; 0: r itself", (0, 1)]
    acceleration: Annotated[float, "y/tick²", "largest second difference of r_s, R T²"]


class State(Struct):
    """State."""

    previous_reference: Annotated[float, "y", "r of the last tick"]
    shaped: Annotated[float, "y", "r_s"]
    speed: Annotated[float, "y/tick", "change of r_s in the last tick"]


@firmware
def tracked_reference(constants: Constants, state: State, reference: float) -> float:
    """What C tracks: the reference, shaped where the table says so."""
    tracked = reference
    if constants.enabled:
        tracked = shape_reference(constants, state, reference)
    return tracked


@firmware
def shape_reference(constants: Constants, state: State, reference: float) -> float:
    """Return r_s of this tick: ``reference`` itself if within reach."""
    largest = constants.acceleration
    moved = reference - state.previous_reference
    state.previous_reference = reference
    distance = reference - (state.shaped + moved)
    previous = state.speed
    speed = moved + np.copysign(braking_speed(abs(distance) / largest) * largest, distance)
    if speed > previous + largest:
        speed = previous + largest
    elif speed < previous - largest:
        speed = previous - largest
    elif abs(distance) <= largest:  # the remaining distance is covered in this tick
        state.speed = speed
        state.shaped = reference
        return reference
    state.speed = speed
    state.shaped += speed
    shaped: float = state.shaped
    return shaped


@firmware
def braking_speed(distance: float) -> float:
    """The v with v + (v - 1) + ... over n terms = ``distance``, for the least n with v ≤ n."""
    half, one = real(0.5, distance), real(1.0, distance)
    if not distance > one:
        return distance
    n = np.ceil(half * (np.sqrt(one + real(8.0, distance) * distance) - one))
    speed: float = distance / n + half * (n - one)
    return speed


@firmware
def start(state: State, reference: float) -> None:
    """Let r_s rest at ``reference``."""
    state.previous_reference = reference
    state.shaped = reference
    state.speed = 0.0
