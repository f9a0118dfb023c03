"""What d̂ is if channel 1 is lost: w, the answer of G1 to the commands since the loss.

The thesis's (2.9) for a loss of all: what channel 1 would have added to y. Of a part s, d̂ = s w. A
loss is detected some ticks after it happened, so w starts in the past (``initialise_loss_model``)
and runs with every command from then on, computed or held. Once the channel works again w is driven
with zero, and fades as fast as the channel comes back.
"""

from __future__ import annotations

import math

from firmware_model.compiled import firmware
from firmware_model.target.filters import biquad
from firmware_model.target.filters.biquad import advance, output
from firmware_model.target.precision import real
from firmware_model.target.status import FaultState
from firmware_model.target.structs import MAX_LATENCY_TICKS, Field, Record

SUSPECTED, CONFIRMED = int(FaultState.SUSPECTED), int(FaultState.CONFIRMED)

NEAR = 0.9  # of |d̂|: w grows with the square of time, so this is between one tick and the next

CONSTANTS = (Field("memory", "1", "what a tick leaves of the sums and of the offset"),)
STATE = (
    Field("channel_1", "y", "state of G1 driven by the commands since the loss", biquad.STATE),
    Field("previous_output", "y", "w of the last tick"),
    Field("delay", "y", "ring of w on its way into d̂", shape=(MAX_LATENCY_TICKS,)),
    Field("offset", "y", "d̂ from before the loss, fading"),
    Field("share_before", "1", "d̂ as a share of G1 u1 before the loss"),
    Field("share", "1", "s, the part of channel 1 that is lost, as d̂ shows it"),
    Field("sums", "y²", "of d̂ w and of w², fading", shape=(2,)),
)


@firmware
def initialise_loss_model(table: Record, state: Record, estimate: float, model_1: float) -> None:
    """Start w where it makes the first d̂ over the threshold: at the loss, some ticks ago.

    d̂ shows what channel 1 has not done so far. G1 is driven with the command that acted last, for
    as many ticks as its output takes to come near to d̂; then with the commands on their way.
    How much of the channel is lost, ``estimate_loss_share`` learns from the ticks that follow.

    Where the model is not trusted, only the change of d̂ is put down to the loss.

    Args:
        table: the constant table.
        state: changed in place.
        estimate: d̂.
        model_1: G1 u1 as d̂ contains it.
    """
    g1, acting, loss = table.estimator.channel_1, state.estimator, state.loss_model
    share = table.adaptive_threshold.model_share
    caused = state.adaptive_threshold.change if share > 0.0 else estimate
    loss.offset = estimate - caused
    before = real(0.0, estimate)
    if abs(model_1) > table.adaptive_threshold.threshold:
        before = loss.offset / model_1
    loss.share_before = min(max(before, -share), share)
    loss.sums[:] = 0.0
    loss.share = 1.0
    loss.channel_1.accumulators[:] = 0.0
    previous = now = real(0.0, estimate)
    for _ in range(MAX_LATENCY_TICKS):
        advance(g1, loss.channel_1, acting.acting_1)
        previous = now
        now = output(g1, loss.channel_1, acting.acting_1)
        if abs(now) >= real(NEAR, caused) * abs(caused):
            break
    for i in range(table.estimator.latency_ticks):
        index = (acting.delay_index + i) % table.estimator.latency_ticks
        previous = output(g1, loss.channel_1, acting.delay_1[index])
        loss.delay[index] = previous
        advance(g1, loss.channel_1, acting.delay_1[index])
    loss.previous_output = previous


@firmware
def estimate_loss_share(table: Record, state: Record, estimate: float, lost: float) -> None:
    """Learn s, 0..1, from d̂ and w of this tick: least squares of d̂ = s w with a fading memory.

    Where w is below the threshold, or a square overflows, nothing is learnt. w grows from zero, so
    the first ticks, which say least, soon weigh nothing. What was in d̂ before the loss does not
    count; it fades as the motion does that the channel had caused.
    """
    loss, memory = state.loss_model, table.loss_model.memory
    loss.offset = memory * loss.offset
    if not abs(lost) > table.adaptive_threshold.threshold:
        return
    product = memory * loss.sums[0] + (estimate - loss.offset) * lost
    square = memory * loss.sums[1] + lost * lost
    if square > 0.0 and math.isfinite(product) and math.isfinite(square):
        loss.sums[0], loss.sums[1] = product, square
        loss.share = min(max(product / square, real(0.0, square)), real(1.0, square))


@firmware
def loss_output(table: Record, state: Record) -> float:
    """w of this tick, as this tick's command drives it."""
    w: float = output(table.estimator.channel_1, state.loss_model.channel_1, lost_command(state))
    return w


@firmware
def lost_command(state: Record) -> float:
    """The part of command 1 that is believed not to act: all of it, or nothing."""
    command: float = state.command_1
    if state.fault_state in (SUSPECTED, CONFIRMED):
        return command
    return real(0.0, command)


@firmware
def loss_output_in_estimate(table: Record, state: Record) -> float:
    """w as d̂ of this tick contains it, ``latency_ticks`` late."""
    if table.estimator.latency_ticks > 0:
        w: float = state.loss_model.delay[state.estimator.delay_index]
        return w
    return loss_output(table, state)


@firmware
def advance_loss_model(table: Record, state: Record) -> float:
    """Advance w by this tick's command, computed or held; returns w of this tick."""
    loss = state.loss_model
    w: float = advance(table.estimator.channel_1, loss.channel_1, lost_command(state))
    loss.previous_output = w
    if table.estimator.latency_ticks > 0:
        loss.delay[state.estimator.delay_index] = w
    return w


@firmware
def clear_loss_model(state: Record) -> None:
    """Nothing is lost."""
    loss = state.loss_model
    loss.channel_1.accumulators[:] = 0.0
    loss.offset = 0.0
