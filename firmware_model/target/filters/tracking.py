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
    Field("loop_inverse", "1", "1/(1 - gain of the loop u1 → G1 u1 → u1 within a tick)"),
)
STATE = (
    Field("filter", "u1", "state of Q", biquad.STATE),
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
    torque: float = output(constants.filter, state.filter, error) * constants.loop_inverse
    return torque


@firmware
def track(constants: Record, state: Record, error: float) -> None:
    """Advance Q by ``error`` = r - y + G1 u1, this tick's command included as it was limited."""
    state.error = error
    advance(constants.filter, state.filter, error)


@firmware
def track_on(constants: Record, state: Record) -> float:
    """A tick without inputs, which nothing new has happened in; what C would have asked for."""
    torque: float = advance(constants.filter, state.filter, state.error)
    return torque


@firmware
def advance_shortfalls(table: Record, state: Record, short_1: float, short_2: float) -> None:
    """Advance what the channels could not do by this tick's asked - possible."""
    advance(table.estimator.channel_1, state.shortfall_1, short_1)
    missing = advance(table.estimator.channel_2, state.shortfall_2, short_2)
    if table.estimator.shown_ticks_2 > 0:
        state.tracking.delay[state.estimator.shown_index_2] = missing


@firmware
def settle_tracking(constants: Record, state: Record, reference: float) -> float:
    """The steady state at ``reference`` of a plant that is the model; returns the command."""
    state.delay[:] = 0.0
    state.error = reference
    command: float = settle(constants.filter, state.filter, reference)
    return command
