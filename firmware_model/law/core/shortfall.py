"""The shortfall of an actuator (asked minus possible command), and the make-up.

The missing output, G (asked - possible), comes from the model, so the output is known exactly and
causes no windup. Without a make-up the missing output fades with the plant. The make-up adds a
command to the next asked command: among all possible commands of this tick the command with the
least remaining missing output, without any further make-up,

    V = Σ y², y the missing output from this tick on = y² + xᵀ P x,  P = Aᵀ P A + cᵀ c,

x the state of G driven by asked - possible. V is a parabola in the command, so the best command of
a range is the nearest to the minimum v = gain · x: whatever the limits, V shrinks at least as fast
as without a make-up, and no oscillation can start. The actuator can always take back a make-up
within a tick: under a rate limit the asked command must stay in reach.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.precision import real
from firmware_model.law.structs import MAX_SECTIONS, FloatArray, Struct

if TYPE_CHECKING:
    from firmware_model.law.core import actuator


class Constants(Struct):
    """Constants."""

    gain: Annotated[FloatArray, "command/y", "v for each accumulator of G", (MAX_SECTIONS, 2)]


State = biquad.State  # of G driven by asked - possible


@firmware
def make_up(
    constants: Constants,
    cascade: biquad.Constants,
    actuator: actuator.Constants,
    state: biquad.State,
) -> float:
    """Return the make-up, an addition to this tick's asked command.

    Args:
        constants: of this module.
        cascade: G, as F1 has it.
        actuator: its limits.
        state: of this module.
    """
    gain, accumulators = constants.gain, state.accumulators
    best = real(0.0, actuator.slew)
    for i in range(cascade.n):
        best += gain[i, 0] * accumulators[i, 0] + gain[i, 1] * accumulators[i, 1]
    command: float = min(max(best, -actuator.slew), actuator.slew)
    return command
