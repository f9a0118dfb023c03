"""Bumpless transfer: a late compensation makes up the missed output without a bump.

When the compensation on confirmation engages, no command has carried the value and the speed of s w
so far (s w is the lost channel's share of y). F̂ differentiates twice: a step of s w would drive
channel 2 to one limit and then to the other. So F̂ gets

    s w - m,    m = (m0 + b k) p^k,    k = 0 in the tick before the loss was confirmed,

where m begins with the value m0 and the speed of s w: the input of F̂ begins at zero with zero
speed (or with its last value and speed, if an earlier loss is still being released or inputs were
missing). m fades like a critically damped motion. Its pace, -ln p, is twice the speed over the
value: d̂ grows with the square of time, so the make-up takes about as many ticks as the detection,
with a few times the force of the steady load; m rises to 1.08 m0 meanwhile. A loss detected at its
first sample is made up almost at once; a loss with a settled w, at the pace of the car.
"""

from __future__ import annotations

import math
from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.exponential import exp_minus
from firmware_model.law.structs import Struct


class Constants(Struct):
    """Constants."""

    slowest_pace: Annotated[float, "1/tick", "least -ln p: the pace of the car"]
    haste: Annotated[float, "1", "-ln p over the speed of s w by its value"]


class State(Struct):
    """State."""

    missed: Annotated[float, "y", "m, the part of s w held back from F̂"]
    missed_growth: Annotated[float, "y/tick", "b of m, as of this tick"]
    missed_memory: Annotated[float, "1", "p of m"]
    carried: Annotated[float, "y", "input of F̂ in the last tick"]
    carried_speed: Annotated[float, "y/tick", "change of the input of F̂ in the last tick"]


@firmware
def begin_transfer(constants: Constants, state: State, lost: float, speed: float) -> None:
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
    if not math.isfinite(pace):  # the missed output is negligible
        return
    pace = max(constants.haste * pace, constants.slowest_pace)
    state.missed = missed
    state.missed_growth = missed_speed + pace * missed
    state.missed_memory = exp_minus(pace)


@firmware
def transfer(state: State, lost: float) -> float:
    """The input of F̂ in this tick, where s w is ``lost``."""
    state.missed = state.missed_memory * (state.missed + state.missed_growth)
    state.missed_growth = state.missed_memory * state.missed_growth
    carried: float = lost - state.missed
    state.carried_speed = carried - state.carried
    state.carried = carried
    return carried


@firmware
def release(state: State) -> None:
    """Empty F̂ and forget its past output."""
    state.missed = state.missed_growth = state.carried = state.carried_speed = 0.0
