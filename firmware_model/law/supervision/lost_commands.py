"""Commands that came too late to act: the models of the plant undo the late commands.

F1 goes on with the commands of the actuators. The missing output is a shortfall, and the law makes
up for a shortfall. A lost channel, known or not, does not owe a command that never arrived.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from firmware_model.compiled import firmware
from firmware_model.law.core.biquad import advance
from firmware_model.law.precision import real
from firmware_model.law.status import FaultState
from firmware_model.law.structs import MAX_SECTIONS, Records

if TYPE_CHECKING:
    from firmware_model.law.core import biquad, estimator, tracking
    from firmware_model.law.layout import State, Table
    from firmware_model.law.supervision import likelihood_ratio, loss_model


CONFIRMED = int(FaultState.CONFIRMED)


@firmware
def revise(queue: estimator.Queue, ticks: int, waits: int, command: float) -> float:
    """Put ``command`` in place of the command that has waited for ``waits`` ticks; return that."""
    at = (queue.index + ticks - waits) % max(ticks, 1)
    before: float = queue.commands[at]
    queue.commands[at] = command
    return before


@firmware
def act(
    table: Table, state: State, motion: biquad.State, command_1: float, command_2: float
) -> None:
    """Let these commands act from the next tick on, in place of the late commands.

    Args:
        table: the constant table, of a latency of at least one tick.
        state: changed in place.
        motion: a state of any cascade, overwritten.
        command_1: the command of actuator 1.
        command_2: the command of actuator 2.
    """
    constants, model = table.estimator, state.estimator
    owes, latency = state.fault_state == CONFIRMED, constants.latency_ticks
    late_1 = revise(model.queue_1, constants.shown_ticks_1, latency, command_1)
    late_2 = revise(model.queue_2, constants.shown_ticks_2, latency, command_2)
    lost_1 = real(late_1 - command_1, state.command_1)
    lost_2 = real(late_2 - command_2, state.command_2)
    test, loss = state.supervision.sequential_test, state.supervision.loss_model
    first = model.queue_1.index - latency
    lose_command_1(constants, state.shortfall_1, test, loss, owes, motion, first, lost_1)
    first = model.queue_2.index - latency
    lose_command_2(constants, state.shortfall_2, state.tracking, motion, first, lost_2)


@firmware
def lose_command_1(
    constants: estimator.Constants,
    shortfall: biquad.State,
    test: likelihood_ratio.State,
    loss: loss_model.State,
    owes: bool,
    motion: biquad.State,
    first: int,
    lost: float,
) -> None:
    """Subtract ``lost`` from the acting command 1, shown from the index ``first`` on."""
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
            shortfall.accumulators[i, j] += missing
            test.channel_1.accumulators[i, j] -= missing
            if owes:
                loss.channel_1.accumulators[i, j] -= missing


@firmware
def lose_command_2(
    constants: estimator.Constants,
    shortfall: biquad.State,
    tracked: tracking.State,
    motion: biquad.State,
    first: int,
    lost: float,
) -> None:
    """Subtract ``lost`` from the acting command 2, shown from the index ``first`` on."""
    motion.accumulators[:] = 0.0
    for k in range(constants.latency_ticks):
        i = (first + k) % constants.shown_ticks_2
        tracked.delay[i] += advance(constants.channel_2, motion, lost)
        lost = real(0.0, lost)
    for i in range(MAX_SECTIONS):
        for j in range(2):
            shortfall.accumulators[i, j] += motion.accumulators[i, j]


@firmware
def act_first(
    tables: Records[Table],
    states: Records[State],
    motions: Records[biquad.State],
    command_1: float,
    command_2: float,
) -> None:
    """``act`` for the first of the controllers; see ``controller.step_first``."""
    act(tables[0], states[0], motions[0], command_1, command_2)
