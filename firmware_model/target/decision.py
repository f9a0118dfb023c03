"""Is channel 1 lost? What is made of the fault estimate d̂, tick by tick.

Two hypotheses are compared, each with what it makes of d̂:

    works   d̂ = 0, but for what the budget of ``suspicion`` allows
    lost    d̂ = w, the answer of G1 to the commands since the loss: what channel 1 would have added

A d̂ that is too much is SUSPECTED at once and CONFIRMED after ``confirm_ticks`` in a row. It is
cleared when for ``clear_ticks`` |d̂| stays below the threshold while ``clear_ratio`` of |w| is
above: a reference that passes through zero takes d̂ and w along and clears nothing. Ticks to clear
should outlast the ringing of G1, which d̂ follows when the channel comes back.

None of this isolates the torque channel: a bias b of the D* sensor gives d̂ = -b, a change of the
car gives some d̂. A table with a ``probe`` asks the motor before it confirms: d̂ that does not answer
to a small torque stays SUSPECTED. Where channel 1 asks for so little that its loss would not show,
silence means nothing, and the state is CANNOT_TELL instead of CLEAR.
"""

from __future__ import annotations

import math

from firmware_model.compiled import firmware
from firmware_model.target.adaptive_threshold import too_much, watch, would_show
from firmware_model.target.biquad import advance, output
from firmware_model.target.bumpless_transfer import begin_handover, let_go
from firmware_model.target.layout import MAX_LATENCY_TICKS, FaultState, Record
from firmware_model.target.probe import begin, listen, share_heard

CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = (
    int(FaultState.CLEAR),
    int(FaultState.SUSPECTED),
    int(FaultState.CONFIRMED),
    int(FaultState.CANNOT_TELL),
)

NEAR = 0.9  # of |d̂|: w grows with the square of time, so this is between one tick and the next


@firmware
def decide(table: Record, state: Record, estimate: float, at_stake: float, kept: float) -> None:
    """The fault state of this tick.

    Args:
        table: the constant table.
        state: changed in place.
        estimate: d̂.
        at_stake: what channel 1, if it works, adds to y at this tick by the model.
        kept: what channel 2 adds.
    """
    watch(table, state, estimate, at_stake + kept if state.engaged else at_stake)
    over = too_much(table, state, estimate)
    if over and state.fault_state not in (SUSPECTED, CONFIRMED):
        explain(table, state, estimate, at_stake)
    if over or state.fault_state in (SUSPECTED, CONFIRMED):
        weigh(table, state, estimate, lost_as_seen(table, state))
    if state.fault_state == CONFIRMED:
        look_for_recovery(table, state, estimate, at_stake)
    elif state.probe_at > 0:
        if listen(table, state, estimate, lost_as_seen(table, state)):
            if share_heard(state) >= table.probe_share:
                confirm(table, state)
            else:
                state.decide_ticks = table.confirm_ticks - table.clear_ticks  # the next, later
    elif over:
        state.decide_ticks += 1
        state.fault_state = SUSPECTED
        if state.decide_ticks >= table.confirm_ticks:
            if table.probe_ticks > 0:
                begin(state)
            else:
                confirm(table, state)
    else:
        state.decide_ticks = 0
        state.fault_state = CLEAR if would_show(table, state, at_stake) else CANNOT_TELL


@firmware
def look_for_recovery(table: Record, state: Record, estimate: float, at_stake: float) -> None:
    """Clear a confirmed loss once a channel that is lost would have shown for long enough.

    Another car shows its share of w without a loss: the one that it had before. It is taken to be
    whole again where d̂ is nearer to that than to the loss that was found, which is learnt slowly:
    at first, while w is small, the share that is lost comes out too large.
    """
    seen = lost_as_seen(table, state)
    lost = abs(seen)
    if lost >= 0.5 * abs(at_stake):
        slow = table.found_memory
        state.share_found = slow * state.share_found + (1.0 - slow) * state.share_lost
    nearer = 0.5 * abs(state.share_found - state.share_before)
    others = min(table.model_share, nearer) * lost
    shows = table.clear_ratio * (lost - others) > table.threshold
    off = abs(estimate - state.share_before * seen)
    if off > table.threshold + others or not shows:
        state.decide_ticks = 0
        return
    state.decide_ticks += 1
    if state.decide_ticks >= table.clear_ticks:
        state.fault_state = CLEAR
        state.decide_ticks = 0


@firmware
def confirm(table: Record, state: Record) -> None:
    """Take channel 1 for lost."""
    state.fault_state = CONFIRMED
    state.decide_ticks = 0
    state.share_found = 0.0
    state.engaged = table.on_confirmation
    carry(table, state)


@firmware
def carry(table: Record, state: Record) -> None:
    """Let F̂ go over to the w and the share of now."""
    before, share = state.lost_before, state.share_lost
    begin_handover(table, state, share * before, share * (lost_now(table, state) - before))


@firmware
def explain(table: Record, state: Record, estimate: float, at_stake: float) -> None:
    """Start w where it makes the first d̂ over the threshold: at the loss, some ticks ago.

    d̂ shows what channel 1 did not do until now. It is given the command of then for one tick, and
    more until the model's answer comes near to d̂; after that, the commands still on their way.
    How much of the channel is lost, ``weigh`` finds out from the ticks that follow.

    Where the car is not trusted to be the model, only what has changed of late is the loss's.
    """
    caused = state.change if table.model_share > 0.0 else estimate
    state.offset = estimate - caused
    before = state.offset / at_stake if abs(at_stake) > table.threshold else 0.0
    state.share_before = min(max(before, -table.model_share), table.model_share)
    state.share_sums[:] = 0.0
    state.share_lost = 1.0
    state.lost[:] = 0.0
    shown = before = estimate - estimate
    for _ in range(MAX_LATENCY_TICKS):
        advance(table.estimator_1, state.lost, table.estimator_1_n, state.acting_1)
        before = shown
        shown = output(table.estimator_1, state.lost, table.estimator_1_n, state.acting_1)
        if abs(shown) >= NEAR * abs(caused):
            break
    for i in range(table.latency_ticks):
        at = (state.delay_at + i) % table.latency_ticks
        before = output(table.estimator_1, state.lost, table.estimator_1_n, state.delay_1[at])
        state.delay_lost[at] = before
        advance(table.estimator_1, state.lost, table.estimator_1_n, state.delay_1[at])
    state.lost_before = before
    if state.engaged:  # the loss before this one is still being handed back
        carry(table, state)


@firmware
def weigh(table: Record, state: Record, estimate: float, expected: float) -> None:
    """The share s of channel 1 that is lost, 0..1: least squares of d̂ = s w with a fading memory.

    Where w is below the threshold, or a square is out of range, nothing is learnt. It grows from
    zero, so what was seen first, and says least, soon weighs nothing. The d̂ that was there before
    the loss does not count; it fades as the motion does that the channel had caused.
    """
    state.offset = table.share_memory * state.offset
    if not abs(expected) > table.threshold:
        return
    seen = table.share_memory * state.share_sums[0] + (estimate - state.offset) * expected
    of = table.share_memory * state.share_sums[1] + expected * expected
    if of > 0.0 and math.isfinite(seen) and math.isfinite(of):
        state.share_sums[0], state.share_sums[1] = seen, of
        state.share_lost = min(max(seen / of, 0.0), 1.0)


@firmware
def lost_now(table: Record, state: Record) -> float:
    """w of this tick, before the bus: G1 driven by command 1 for as long as that is believed lost.

    A channel that works again is driven with zero: w then fades as fast as the channel comes back.
    """
    u1 = believed_lost(state)
    w: float = output(table.estimator_1, state.lost, table.estimator_1_n, u1)
    return w


@firmware
def believed_lost(state: Record) -> float:
    """The part of command 1 that is believed not to act: all of it, or nothing."""
    u1 = state.command_1
    lost: float = u1 if state.fault_state in (SUSPECTED, CONFIRMED) else u1 - u1
    return lost


@firmware
def lost_as_seen(table: Record, state: Record) -> float:
    """w as d̂ shows it now, ``latency_ticks`` late."""
    if table.latency_ticks > 0:
        seen: float = state.delay_lost[state.delay_at]
        return seen
    return lost_now(table, state)


@firmware
def remember(table: Record, state: Record) -> None:
    """Advance w by this tick; release the compensation once nothing of it is left."""
    w = lost_now(table, state)
    state.lost_before = w
    advance(table.estimator_1, state.lost, table.estimator_1_n, believed_lost(state))
    if table.latency_ticks > 0:
        state.delay_lost[state.delay_at] = w
    if state.fault_state == CLEAR and abs(w) < table.threshold * table.clear_ratio:
        state.engaged = 0
        let_go(state)
