"""What an actuator could not do of what it was asked for, and how that is made up for.

The output that is missing, G (asked - possible), is the model's, so it is known exactly and winds
nothing up. Left alone it fades as the plant lets it. Instead a command is added to the next one
asked for: of all that the actuator can do in this tick the one after which the least is still to
come, if nothing more were done,

    V = Σ y², y the missing output from this tick on = y² + xᵀ P x,  P = Aᵀ P A + cᵀ c,

x the state of G that is driven by asked - possible. V is a parabola in the command, so of a range
of commands the nearest to its minimum, v = gain · x, is the best: whatever the limits, V shrinks at
least as it would without a make-up, and nothing can swing. A make-up is never more than its
actuator can take back within a tick: where a rate is limited, what is asked for must stay in reach.
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.filters import biquad
from firmware_model.target.precision import real
from firmware_model.target.structs import MAX_SECTIONS, Field, Record

CONSTANTS = (
    Field(
        "gain", "command/y", "v for each accumulator of the model: the best make-up of a tick",
        shape=(MAX_SECTIONS, 2),
    ),
)  # fmt: skip
STATE = biquad.STATE  # of G driven by asked - possible


@firmware
def make_up(constants: Record, cascade: Record, actuator: Record, state: Record) -> float:
    """What to add to the command that is asked for in this tick.

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
