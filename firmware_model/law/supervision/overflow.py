"""Recovery of the memories: a lost number must not stay lost, a damaged index reaches nothing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from firmware_model.compiled import firmware
from firmware_model.law.core.biquad import output
from firmware_model.law.core.estimator import model_output
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
from firmware_model.law.supervision.steady_state import settle_estimator
from firmware_model.law.supervision.takeover import UNKNOWN, end_takeover
from firmware_model.law.supervision.verdict import clear_hypotheses
from firmware_model.law.supervision.witness import settle_witness

if TYPE_CHECKING:
    from firmware_model.law.core import estimator, thesis
    from firmware_model.law.layout import Supervision, Table
    from firmware_model.law.supervision import echoes, mismatch, witness


@firmware
def clear_memories(table: Table, core: thesis.State, own: Supervision) -> None:
    """Restart the memories fed by the measurement; keep finite memories of the commands.

    A known loss stays known.
    """
    core.tracking.filter.accumulators[:] = 0.0
    core.tracking.stabiliser.accumulators[:] = 0.0
    core.tracking.error = 0.0
    core.estimator.one_plus_q.accumulators[:] = 0.0
    core.estimator.measurement.accumulators[:] = 0.0
    if not table.compensator.on_confirmation:
        core.compensator.filter.accumulators[:] = 0.0
    clear_mismatch(table.mismatch, own.mismatch)
    if not math.isfinite(sum_of_models(table, core, own)):
        clear_models(core, own)
    restart_test(table, core, own)
    clear_hypotheses(own.hypotheses)
    settle_witness(own.witness, real(0.0, core.command_1))
    settle_corroboration(own.corroboration)
    clear_prediction(own.prediction)
    end_takeover(own.takeover)


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
def repair(table: Table, core: thesis.State, own: Supervision) -> None:
    """A damaged state trusts nothing but its commands, as if they had stood for long."""
    if not is_damaged(core.estimator, own.echoes, own.witness, own.mismatch):
        return
    one, two = core.command_1, core.command_2
    settle_estimator(table.estimator, core.estimator, one, two, real(0.0, one))
    clear_models(core, own)
    own.echoes.index = own.witness.index = 0
    own.mismatch.covariance.first = LOSS_STATES
    clear_memories(table, core, own)


@firmware
def sum_of_models(table: Table, core: thesis.State, own: Supervision) -> float:
    """Sum of all memories of the commands: not finite if one memory is lost."""
    zero = real(0.0, core.command_1)
    model_1, model_2 = model_output(table.estimator, core.estimator, zero, zero)
    known = model_1 + model_2 + missing_by_loss(table, core, own)
    known += missing_output(table.estimator, core.tracking, core.estimator, core.shortfall_2)
    show_other_cars(table, own.other_cars, core.estimator.measured, zero, zero)
    for i in range(table.other_cars.n):
        known += own.other_cars.shown[i]
    force = output(table.compensator.filter, core.compensator.filter, zero)
    constants, lost_1, lost_2 = table.estimator, core.shortfall_1, core.shortfall_2
    force += make_up(table.shortfall_1, constants.channel_1, table.actuator_1, lost_1)
    force += make_up(table.shortfall_2, constants.channel_2, table.actuator_2, lost_2)
    total: float = known + force + core.reference_shaper.shaped
    return total


@firmware
def clear_models(core: thesis.State, own: Supervision) -> None:
    """Forget the plant and the loss: the next tick with both inputs may be a takeover."""
    start(core.reference_shaper, real(0.0, core.command_1))
    core.shortfall_1.accumulators[:] = 0.0
    core.shortfall_2.accumulators[:] = 0.0
    core.tracking.delay[:] = 0.0
    core.actuator_1.rounded_off = core.actuator_2.rounded_off = 0.0
    core.compensator.filter.accumulators[:] = 0.0
    core.estimator.channel_1.accumulators[:] = 0.0
    core.estimator.channel_2.accumulators[:] = 0.0
    clear_loss_model(own.loss_model)
    clear_other_cars(own.other_cars)
    release(own.bumpless_transfer)
    own.takeover.pending = UNKNOWN
    core.fault_state = CLEAR
