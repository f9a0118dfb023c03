"""Is channel 1 lost? What is made of the fault estimate d̂, tick by tick.

Two hypotheses are compared, each with what it expects of d̂:

    works   d̂ = 0, but for what the adaptive threshold allows
    lost    d̂ = w, the output of the loss model: what channel 1 would have added to y

A d̂ that exceeds the threshold is SUSPECTED at once and CONFIRMED after ``confirm_ticks`` in a row.
It is cleared when for ``clear_ticks`` in a row |d̂| is below the threshold while ``clear_ratio`` of
|w| is above it: a reference that passes through zero takes d̂ and w along and clears nothing.
``clear_ticks`` should outlast the ringing of G1, which d̂ follows when the channel comes back.

None of this isolates the torque channel: a bias b of the D* sensor gives d̂ = -b, a change of the
car gives some d̂. A table with a ``probe`` tests the motor before it confirms: a d̂ that does not
answer to a small torque stays SUSPECTED. Where channel 1 contributes so little that its loss would
not show, a small d̂ says nothing, and the state is CANNOT_TELL instead of CLEAR.
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.fault_decision.adaptive_threshold import (
    adapt,
    exceeds_threshold,
    would_exceed_threshold,
)
from firmware_model.target.fault_decision.bumpless_transfer import begin_transfer, release
from firmware_model.target.fault_decision.loss_model import (
    estimate_loss_share,
    initialise_loss_model,
    loss_output,
    loss_output_in_estimate,
)
from firmware_model.target.fault_decision.probe import begin_probe, correlate, end_probe
from firmware_model.target.precision import real
from firmware_model.target.status import FaultState
from firmware_model.target.structs import Field, Record

CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = (
    int(FaultState.CLEAR),
    int(FaultState.SUSPECTED),
    int(FaultState.CONFIRMED),
    int(FaultState.CANNOT_TELL),
)

CONSTANTS = (
    Field("confirm_ticks", "tick", "in a row above the threshold that confirm a loss", "int32"),
    Field("clear_ticks", "tick", "in a row in which channel 1 works that clear it", "int32"),
    Field("share_memory", "1", "what a tick leaves of the confirmed share"),
)
STATE = (
    Field("ticks", "tick", "in a row that speak for another fault state", "int32"),
    Field("engaged", "1", "1: the compensation on confirmation acts", "int32"),
    Field("confirmed_share", "1", "part of channel 1 that is lost, learnt slower than a recovery"),
)


@firmware
def decide(table: Record, state: Record, estimate: float, model_1: float, model_2: float) -> None:
    """The fault state of this tick.

    Args:
        table: the constant table.
        state: changed in place.
        estimate: d̂.
        model_1: G1 u1 as d̂ contains it: what channel 1, if it works, adds to y.
        model_2: G2 u2 likewise.
    """
    constants, decision, before = table.decision, state.decision, state.fault_state
    threshold, adapted = table.adaptive_threshold, state.adaptive_threshold
    confirmed, known = before == CONFIRMED, before in (SUSPECTED, CONFIRMED)
    watched = model_1 + model_2 if decision.engaged else model_1
    adapt(threshold, adapted, estimate, watched, confirmed)
    exceeds = exceeds_threshold(threshold, adapted, estimate)
    if exceeds and not known:
        initialise_loss_model(table, state, estimate, model_1)
        if decision.engaged:  # the compensation of an earlier loss is still being released
            engage(table, state)
    if exceeds or known:
        estimate_loss_share(table, state, estimate, loss_output_in_estimate(table, state))
    if confirmed:
        look_for_recovery(table, state, estimate, model_1)
    elif state.probe.tick > 0:
        evaluate_probe(table, state, estimate)
    elif exceeds:
        decision.ticks += 1
        state.fault_state = SUSPECTED
        if decision.ticks >= constants.confirm_ticks:
            if table.probe.ticks > 0:
                begin_probe(state.probe)
            else:
                confirm(table, state)
    else:
        decision.ticks = 0
        shows = would_exceed_threshold(threshold, adapted, model_1)
        state.fault_state = CLEAR if shows else CANNOT_TELL


@firmware
def evaluate_probe(table: Record, state: Record, estimate: float) -> None:
    """Take in a tick of the probe; at its end confirm the loss, or wait with the next probe."""
    w = loss_output_in_estimate(table, state)
    if not correlate(table.probe, state.probe, estimate, w):
        return
    if end_probe(state.probe) >= table.probe.least_share:
        confirm(table, state)
    else:  # the next one is due after clear_ticks
        state.decision.ticks = table.decision.confirm_ticks - table.decision.clear_ticks


@firmware
def look_for_recovery(table: Record, state: Record, estimate: float, model_1: float) -> None:
    """Clear a confirmed loss once channel 1 has been seen to work for long enough.

    Another car shows its share of w without a loss: the one from before it. The channel is taken to
    work again where d̂ is nearer to that share than to the confirmed one, which is learnt slowly: at
    first, while w is small, the share that is lost comes out too large.
    """
    constants, decision, loss = table.decision, state.decision, state.loss_model
    w = loss_output_in_estimate(table, state)
    size = abs(w)
    half, one = real(0.5, size), real(1.0, size)
    if size >= half * abs(model_1):
        slow = constants.share_memory
        decision.confirmed_share = slow * decision.confirmed_share + (one - slow) * loss.share
    nearer = half * abs(decision.confirmed_share - loss.share_before)
    other_cars = min(table.adaptive_threshold.model_share, nearer) * size
    threshold = table.adaptive_threshold.threshold
    loss_would_show = table.adaptive_threshold.clear_ratio * (size - other_cars) > threshold
    distance = abs(estimate - loss.share_before * w)
    if distance > threshold + other_cars or not loss_would_show:
        decision.ticks = 0
        return
    decision.ticks += 1
    if decision.ticks >= constants.clear_ticks:
        state.fault_state = CLEAR
        decision.ticks = 0


@firmware
def confirm(table: Record, state: Record) -> None:
    """Take channel 1 for lost; compensate for it where the table says so."""
    state.fault_state = CONFIRMED
    state.decision.ticks = 0
    state.decision.confirmed_share = 0.0
    state.decision.engaged = table.compensator.on_confirmation
    engage(table, state)


@firmware
def engage(table: Record, state: Record) -> None:
    """Begin a bumpless transfer of F̂ to the s w of now."""
    share, previous = state.loss_model.share, state.loss_model.previous_output
    speed = share * (loss_output(table, state) - previous)
    begin_transfer(table.bumpless_transfer, state.bumpless_transfer, share * previous, speed)


@firmware
def disengage_when_faded(table: Record, state: Record, w: float) -> None:
    """End the compensation of a loss that is over, once no more than noise is left of ``w``."""
    threshold = table.adaptive_threshold
    if state.fault_state == CLEAR and abs(w) < threshold.threshold * threshold.clear_ratio:
        state.decision.engaged = 0
        release(state.bumpless_transfer)
