"""Commands that came too late to act: what the models of the plant have made of them is taken back.

F1 goes on with what the actuators did without them. What is missing is a shortfall, which is made
up for, and a channel that is lost, known or not, does not owe what it was not told.
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.filters.biquad import advance
from firmware_model.target.precision import real
from firmware_model.target.status import FaultState
from firmware_model.target.structs import MAX_SECTIONS, Record, RecordArray

CONFIRMED = int(FaultState.CONFIRMED)


@firmware
def act(table: Record, state: Record, motion: Record, command_1: float, command_2: float) -> None:
    """These commands act from the next tick on, in place of those that should have.

    Args:
        table: the constant table, of a latency of at least one tick.
        state: changed in place.
        motion: a state of any cascade, overwritten.
        command_1: what actuator 1 does.
        command_2: what actuator 2 does.
    """
    estimator = state.estimator
    at = estimator.delay_index
    lost_1 = real(estimator.delay_1[at] - command_1, state.command_1)
    lost_2 = real(estimator.delay_2[at] - command_2, state.command_2)
    estimator.delay_1[at] = command_1
    estimator.delay_2[at] = command_2
    lose_command_1(table, state, motion, lost_1)
    lose_command_2(table, state, motion, lost_2)


@firmware
def lose_command_1(table: Record, state: Record, motion: Record, lost: float) -> None:
    """``lost`` is missing of the command 1 that would act now."""
    constants, test, loss = table.estimator, state.sequential_test, state.loss_model
    owes = state.fault_state == CONFIRMED or table.decision.tracks_share > 0
    first = state.estimator.shown_index_1 - constants.latency_ticks
    motion.accumulators[:] = 0.0
    for k in range(constants.latency_ticks):
        missing = advance(constants.channel_1, motion, lost)
        i = (first + k) % constants.shown_ticks_1
        test.delay[i] -= missing
        if owes:
            loss.delay[i] -= missing
        lost = real(0.0, lost)
    for i in range(MAX_SECTIONS):
        for j in range(2):
            missing = motion.accumulators[i, j]
            state.shortfall_1.accumulators[i, j] += missing
            test.channel_1.accumulators[i, j] -= missing
            if owes:
                loss.channel_1.accumulators[i, j] -= missing


@firmware
def lose_command_2(table: Record, state: Record, motion: Record, lost: float) -> None:
    """``lost`` is missing of the command 2 that would act now."""
    constants = table.estimator
    first = state.estimator.shown_index_2 - constants.latency_ticks
    motion.accumulators[:] = 0.0
    for k in range(constants.latency_ticks):
        i = (first + k) % constants.shown_ticks_2
        state.tracking.delay[i] += advance(constants.channel_2, motion, lost)
        lost = real(0.0, lost)
    for i in range(MAX_SECTIONS):
        for j in range(2):
            state.shortfall_2.accumulators[i, j] += motion.accumulators[i, j]


@firmware
def act_first(
    tables: RecordArray,
    states: RecordArray,
    motions: RecordArray,
    command_1: float,
    command_2: float,
) -> None:
    """``act`` for the first of the controllers; see ``controller.step_first``."""
    act(tables[0], states[0], motions[0], command_1, command_2)
