"""The reference that the actuator can follow: r with its second derivative limited.

C asks for the second derivative of the reference: G1 has relative degree two, so u1 = r̈/g1 and
more. What a step asks for no motor has, and a limit on the torque alone leaves a loop that brakes
too late: full torque up to the step, full torque back, over and over. So where the motor has a
limit, C follows a reference r_g that gets to r in minimum time with

    |r̈_g| ≤ R

by the time-optimal law of a double integrator in whole ticks (Han and Yuan 1999): the speed from
which equal steps down, one a tick, end exactly at the target, so it neither overshoots nor
chatters. It works in coordinates that move with r: a reference that keeps to R is followed as it
is, exactly and without a tick of delay. All this is outside the loop, and no margin changes.
"""

from __future__ import annotations

import math

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.target.layout import Record


@firmware
def govern(table: Record, state: Record) -> None:
    """Move ``state.governed`` a tick closer to ``state.reference``.

    Speeds are per tick; ``table.slew_reference`` is the largest change of one, R T².
    """
    # In float64 whatever the table's precision: the branches must be those of the interpreter.
    most, r = float(table.slew_reference), float(state.reference)
    moved = r - float(state.reference_before)
    state.reference_before = state.reference
    ahead = r - (float(state.governed) + moved)
    before = float(state.governed_speed)
    speed = moved + math.copysign(braking_speed(abs(ahead) / most) * most, ahead)
    if speed > before + most:
        speed = before + most
    elif speed < before - most:
        speed = before - most
    elif abs(ahead) <= most:  # it gets there in this tick
        state.governed_speed = speed
        state.governed = state.reference
        return
    state.governed_speed = speed
    state.governed = float(state.governed) + speed


@firmware
def braking_speed(distance: float) -> float:
    """The v with v + (v - 1) + ... over n terms = ``distance``, for the least n with v ≤ n."""
    if not distance > 1.0:
        return distance
    n = float(np.ceil(0.5 * (math.sqrt(1.0 + 8.0 * distance) - 1.0)))
    return distance / n + 0.5 * (n - 1.0)


@firmware
def start(state: Record, reference: float, speed: float) -> None:
    """Let the governed reference have come to ``reference`` by ``speed`` in the last tick."""
    state.reference_before = reference
    state.governed = reference
    state.governed_speed = speed
