"""Recovery of the memories: a lost number must not stay lost, a damaged index reaches nothing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from firmware_model.compiled import firmware
from firmware_model.law.core.biquad import output
from firmware_model.law.core.estimator import model_output, settle_estimator
from firmware_model.law.core.reference_shaper import start
from firmware_model.law.core.shortfall import make_up
from firmware_model.law.core.tracking import missing_output
from firmware_model.law.precision import real
from firmware_model.law.structs import MAX_SHOWN_TICKS
from firmware_model.law.supervision.bumpless_transfer import release
from firmware_model.law.supervision.corroboration import settle_corroboration
from firmware_model.law.supervision.covariance import LOSS_STATES
from firmware_model.law.supervision.decision import CLEAR, missing_by_loss, restart_test
from firmware_model.law.supervision.echoes import KEPT_TICKS
from firmware_model.law.supervision.loss_model import clear_loss_model
from firmware_model.law.supervision.mismatch import clear_mismatch
from firmware_model.law.supervision.other_cars import clear_other_cars, show_other_cars
from firmware_model.law.supervision.prediction import clear_prediction
from firmware_model.law.supervision.takeover import UNKNOWN, end_takeover
from firmware_model.law.supervision.verdict import clear_hypotheses
from firmware_model.law.supervision.witness import settle_witness

if TYPE_CHECKING:
    from firmware_model.law.core import estimator
    from firmware_model.law.layout import State, Table
    from firmware_model.law.supervision import echoes, mismatch, witness


@firmware
def clear_memories(table: Table, state: State) -> None:
    """Restart the memories fed by the measurement; keep finite memories of the commands.

    A known loss stays known.
    """
    state.tracking.filter.accumulators[:] = 0.0
    state.tracking.stabiliser.accumulators[:] = 0.0
    state.tracking.error = 0.0
    state.estimator.one_plus_q.accumulators[:] = 0.0
    state.estimator.measurement.accumulators[:] = 0.0
    if not table.compensator.on_confirmation:
        state.compensator.filter.accumulators[:] = 0.0
    clear_mismatch(table.mismatch, state.mismatch)
    if not math.isfinite(sum_of_models(table, state)):
        clear_models(state)
    restart_test(table, state)
    clear_hypotheses(state.hypotheses)
    settle_witness(state.witness, real(0.0, state.command_1))
    settle_corroboration(state.corroboration)
    clear_prediction(state.prediction)
    end_takeover(state.takeover)


@firmware
def is_damaged(
    own: estimator.State, heard: echoes.State, seen: witness.State, known: mismatch.State
) -> bool:
    """Whether an index lies outside its array: no tick leaves it so, but a flipped bit does."""
    queue_1 = outside(own.queue_1.index, MAX_SHOWN_TICKS)
    queue_2 = outside(own.queue_2.index, MAX_SHOWN_TICKS)
    samples = outside(heard.index, KEPT_TICKS) or outside(seen.index, KEPT_TICKS)
    covariance = outside(known.covariance.first, LOSS_STATES + 1)
    damaged: bool = queue_1 or queue_2 or samples or covariance
    return damaged


@firmware
def outside(index: int, size: int) -> bool:
    """Whether an array of ``size`` numbers has no number at ``index``."""
    return index < 0 or index >= size


@firmware
def repair(table: Table, state: State) -> None:
    """A damaged state trusts nothing but its commands, as if they had stood for long."""
    if not is_damaged(state.estimator, state.echoes, state.witness, state.mismatch):
        return
    one, two = state.command_1, state.command_2
    settle_estimator(table.estimator, state.estimator, one, two, real(0.0, one))
    clear_models(state)
    state.echoes.index = state.witness.index = 0
    state.mismatch.covariance.first = LOSS_STATES
    clear_memories(table, state)


@firmware
def sum_of_models(table: Table, state: State) -> float:
    """Sum of all memories of the commands: not finite if one memory is lost."""
    zero = real(0.0, state.command_1)
    model_1, model_2 = model_output(table.estimator, state.estimator, zero, zero)
    known = model_1 + model_2 + missing_by_loss(table, state)
    known += missing_output(table.estimator, state.tracking, state.estimator, state.shortfall_2)
    show_other_cars(table, state.other_cars, state.estimator.measured, zero, zero)
    for i in range(table.other_cars.n):
        known += state.other_cars.shown[i]
    force = output(table.compensator.filter, state.compensator.filter, zero)
    constants, lost_1, lost_2 = table.estimator, state.shortfall_1, state.shortfall_2
    force += make_up(table.shortfall_1, constants.channel_1, table.actuator_1, lost_1)
    force += make_up(table.shortfall_2, constants.channel_2, table.actuator_2, lost_2)
    total: float = known + force + state.reference_shaper.shaped
    return total


@firmware
def clear_models(state: State) -> None:
    """Forget the plant and the loss: the next tick with both inputs may be a takeover."""
    start(state.reference_shaper, real(0.0, state.command_1))
    state.shortfall_1.accumulators[:] = 0.0
    state.shortfall_2.accumulators[:] = 0.0
    state.tracking.delay[:] = 0.0
    state.actuator_1.rounded_off = state.actuator_2.rounded_off = 0.0
    state.compensator.filter.accumulators[:] = 0.0
    state.estimator.channel_1.accumulators[:] = 0.0
    state.estimator.channel_2.accumulators[:] = 0.0
    clear_loss_model(state.loss_model)
    clear_other_cars(state.other_cars)
    release(state.bumpless_transfer)
    state.takeover.pending = UNKNOWN
    state.fault_state = CLEAR
