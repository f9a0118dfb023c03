"""A loss is found late; what was missed until then is made up without a bump.

When the compensation on confirmation engages, s w, what the lost channel would add to y, has a
value and a speed that nobody has carried so far. Given to F̂ at once, which differentiates twice,
they would ask for all that channel 2 has, one way and then the other. So F̂ gets

    s w - m,    m = (m0 + b k) p^k,    k = 0 in the tick before the loss was confirmed,

with m0 = s w of then, and the speed of m that of s w: what F̂ gets begins at zero with a speed of
zero (or, where a loss that has just passed comes back, with what it had), and m fades as a
critically damped motion does. Its pace, -ln p, is the speed over the value:
d̂ grows with the square of time, so what took n ticks to be noticed is made up in about as many,
with some times the force that carries the load anyway; m rises to 1.21 m0 meanwhile. A loss that
shows at its first sample is made up almost at once; one of which w has settled since, with the pace
of the car (``share_memory``).
"""

from __future__ import annotations

import math

from firmware_model.compiled import firmware
from firmware_model.target.layout import Record


@firmware
def begin_handover(table: Record, state: Record, missed: float, speed: float) -> None:
    """From this tick on F̂ carries the load.

    Args:
        table: the constant table.
        state: changed in place.
        missed: s w of the tick before.
        speed: its change since.
    """
    missed = missed - state.carried
    speed = speed - state.carried_rise
    state.missed = state.missed_rise = state.missed_memory = 0.0
    pace = abs(speed / missed) if missed != 0.0 else math.inf
    if math.isfinite(pace):  # else there is nothing to make up
        pace = max(pace, -math.log(table.share_memory))
        state.missed = missed
        state.missed_rise = speed + pace * missed
        state.missed_memory = math.exp(-pace)


@firmware
def hand_over(state: Record, lost: float) -> float:
    """What F̂ gets of ``lost`` in this tick."""
    state.missed = state.missed_memory * (state.missed + state.missed_rise)
    state.missed_rise = state.missed_memory * state.missed_rise
    carried: float = lost - state.missed
    state.carried_rise = carried - state.carried
    state.carried = carried
    return carried


@firmware
def let_go(state: Record) -> None:
    """F̂ carries nothing any more."""
    state.missed = state.missed_rise = state.carried = state.carried_rise = 0.0
