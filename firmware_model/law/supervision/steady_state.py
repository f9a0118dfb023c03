"""The steady state of the thesis's law: a takeover or a repair begins there.

The models have had the same commands for ever, and the plant is the model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from firmware_model.compiled import firmware
from firmware_model.law.core.biquad import settle
from firmware_model.law.precision import real

if TYPE_CHECKING:
    from firmware_model.law.core import estimator, tracking


@firmware
def settle_estimator(
    constants: estimator.Constants,
    state: estimator.State,
    command_1: float,
    command_2: float,
    level: float,
) -> None:
    """The steady state of a healthy plant for constant commands: d̂ = 0.

    ``level`` is y of an integrating plant: with zero commands the plant rests at any y.
    """
    shown = settle(constants.channel_1, state.channel_1, command_1)
    shown += settle(constants.channel_2, state.channel_2, command_2)
    for_one = settle(constants.measurement, state.measurement, real(1.0, command_1))
    if for_one != 0.0:
        level = shown / for_one
    state.measured = level
    settle(constants.measurement, state.measurement, level)
    state.queue_1.commands[:] = command_1
    state.queue_2.commands[:] = command_2
    state.queue_1.index = state.queue_2.index = 0
    state.showing_1, state.showing_2 = command_1, command_2


@firmware
def settle_tracking(
    constants: tracking.Constants, state: tracking.State, reference: float
) -> float:
    """The steady state where M y is ``reference``, of a plant that is the model; the command."""
    state.delay[:] = 0.0
    state.error = reference
    command: float = settle(constants.filter, state.filter, reference)
    if constants.stabiliser.n > 0:  # R is 0 for a constant
        settle(constants.stabiliser, state.stabiliser, command)
    return command
