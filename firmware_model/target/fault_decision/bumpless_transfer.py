"""Bumpless transfer: a compensation that engages late makes up what it missed without a bump.

When the compensation on confirmation engages, s w, what the lost channel would add to y, has a
value and a speed that no command has carried so far. Given to F̂ at once, which differentiates
twice, they would ask for all that channel 2 has, one way and then the other. So F̂ gets

    s w - m,    m = (m0 + b k) p^k,    k = 0 in the tick before the loss was confirmed,

with m0 = s w of then, and the speed of m that of s w: the input of F̂ begins at zero with a speed of
zero (or, where an earlier loss is still being released or inputs were missing, with what it had),
and m fades as a critically damped motion does. Its pace, -ln p, is twice the speed over the value:
d̂ grows with the square of time, so what took n ticks to detect is made up in about as many, with a
few times the force that carries the load anyway; m rises to 1.08 m0 meanwhile. A loss that is
detected at its first sample is made up almost at once; one whose w has settled since, with the pace
of the car.
"""

from __future__ import annotations

import math

from firmware_model.compiled import firmware
from firmware_model.target.exponential import exp_minus
from firmware_model.target.structs import Field, Record

CONSTANTS = (
    Field("slowest_pace", "1/tick", "least -ln p: the pace of the car"),
    Field("haste", "1", "-ln p over the speed of s w by its value"),
)
STATE = (
    Field("missed", "y", "m, the part of s w that F̂ does not get yet"),
    Field("missed_growth", "y/tick", "b of m, as of this tick"),
    Field("missed_memory", "1", "p of m"),
    Field("carried", "y", "input of F̂ in the last tick"),
    Field("carried_speed", "y/tick", "its change in that tick"),
)


@firmware
def begin_transfer(constants: Record, state: Record, lost: float, speed: float) -> None:
    """From this tick on F̂ takes over the lost channel's part of y.

    Args:
        constants: of this module.
        state: of this module; changed in place.
        lost: s w of the last tick.
        speed: its change since.
    """
    missed = lost - state.carried
    missed_speed = speed - state.carried_speed
    state.missed = state.missed_growth = state.missed_memory = 0.0
    if missed == 0.0:
        return
    pace = abs(missed_speed / missed)
    if not math.isfinite(pace):  # so little is missed that there is nothing to make up
        return
    pace = max(constants.haste * pace, constants.slowest_pace)
    state.missed = missed
    state.missed_growth = missed_speed + pace * missed
    state.missed_memory = exp_minus(pace)


@firmware
def transfer(state: Record, lost: float) -> float:
    """The input of F̂ in this tick, where s w is ``lost``."""
    state.missed = state.missed_memory * (state.missed + state.missed_growth)
    state.missed_growth = state.missed_memory * state.missed_growth
    carried: float = lost - state.missed
    state.carried_speed = carried - state.carried
    state.carried = carried
    return carried


@firmware
def release(state: Record) -> None:
    """F̂ carries nothing, and what it once did is forgotten."""
    state.missed = state.missed_growth = state.carried = state.carried_speed = 0.0
