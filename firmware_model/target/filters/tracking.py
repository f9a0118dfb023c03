"""The tracking controller u1 = C (r - y) of (3.32), written so that no limit can make it swing.

C = Q/(1 - Q G1) is the filter Q = q̂/G1 fed with what the model does not explain:

    u1 = Q (r - y + G1 u1)

G1 u1 is the estimator's own: of the command as it was limited and rounded, and as late as the bus
makes it. So as long as the car is the model, y - G1 u1 is its disturbance, whatever the actuator
could not follow: limits of magnitude and rate are outside the loop (internal model control:
Garcia and Morari, Ind. Eng. Chem. Process Des. Dev. 21 (1982) 308). Another car closes the loop by
its difference alone. The gain of Q G1 is 1 at zero frequency: that is the integrator.

After a loss the loop is closed through channel 2. What that was asked for and could not do,
G2 (asked - possible), is taken off the model's output: so its limits are outside the loop too.

Of a plant that is not stable the model is N1, and a filter R of the command holds what would run
away: u1 = Q (r - y + N1 u1) + R u1 (``design.tracking``). Then limits have to stay in the loop.
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.filters import biquad
from firmware_model.target.filters.biquad import advance, output, settle
from firmware_model.target.precision import real
from firmware_model.target.structs import MAX_SHOWN_TICKS, Field, Record

CONSTANTS = (
    Field("filter", "u1/y", "Q; 1 in the open loop", biquad.CONSTANTS),
    Field("feedback", "1", "1: Q works on r - y + G1 u1; 0, the open loop: on r"),
    Field("stabiliser", "1", "R; no section where the plant is stable", biquad.CONSTANTS),
    Field("excuses_limits", "1", "1: what channels could not do is made up for; 0: unstable plant"),
    Field("loop_inverse", "1", "1/(1 - gain of the loop u1 → G1 u1 → u1 within a tick)"),
)
STATE = (
    Field("filter", "u1", "state of Q", biquad.STATE),
    Field("stabiliser", "u1", "state of R", biquad.STATE),
    Field("error", "y", "r - y + G1 u1 of the last tick with inputs"),
    Field("delay", "y", "ring of G2 (asked - possible) on its way", shape=(MAX_SHOWN_TICKS,)),
)


@firmware
def missing_output(table: Record, state: Record) -> float:
    """G2 (asked - possible) as the measurement of this tick shows it."""
    if table.estimator.shown_ticks_2 > 0:
        missing: float = state.tracking.delay[state.estimator.shown_index_2]
        return missing
    none = real(0.0, state.command_2)
    return output(table.estimator.channel_2, state.shortfall_2, none)


@firmware
def asked_torque(constants: Record, state: Record, error: float) -> float:
    """u1 for ``error`` = r - y + G1 u1, where G1 u1 is what it is without this tick's command."""
    torque: float = output(constants.filter, state.filter, error)
    if constants.stabiliser.n > 0:
        torque += output(constants.stabiliser, state.stabiliser, real(0.0, torque))
    inverse: float = constants.loop_inverse
    return torque * inverse


@firmware
def track(constants: Record, state: Record, error: float, command: float) -> None:
    """Advance Q by ``error`` = r - y + G1 u1, this tick's command included as it was limited."""
    state.error = error
    advance(constants.filter, state.filter, error)
    if constants.stabiliser.n > 0:
        advance(constants.stabiliser, state.stabiliser, command)


@firmware
def track_on(constants: Record, state: Record, command: float) -> float:
    """A tick without inputs, which nothing new has happened in; what C would have asked for."""
    torque: float = advance(constants.filter, state.filter, state.error)
    if constants.stabiliser.n > 0:
        torque += advance(constants.stabiliser, state.stabiliser, command)
    return torque


@firmware
def advance_shortfalls(table: Record, state: Record, short_1: float, short_2: float) -> None:
    """Advance what the channels could not do by this tick's asked - possible."""
    counts = table.tracking.excuses_limits
    advance(table.estimator.channel_1, state.shortfall_1, short_1 * counts)
    missing = advance(table.estimator.channel_2, state.shortfall_2, short_2 * counts)
    if table.estimator.shown_ticks_2 > 0:
        state.tracking.delay[state.estimator.shown_index_2] = missing


@firmware
def settle_tracking(constants: Record, state: Record, reference: float) -> float:
    """The steady state where M y is ``reference``, of a plant that is the model; the command."""
    state.delay[:] = 0.0
    state.error = reference
    command: float = settle(constants.filter, state.filter, reference)
    if constants.stabiliser.n > 0:  # R is 0 for a constant
        settle(constants.stabiliser, state.stabiliser, command)
    return command
