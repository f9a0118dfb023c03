"""The commands are taken back to zero, without a bump.

Each command goes to zero in a straight line, as far as the rate limit allows. The models follow.

- Both actuators are lost: no command moves the plant any more, and a standing command would act at
  once if an actuator came back. The commands stay zero until ``reset``. D* alone tells no such
  loss for certain: the torque must be lost, and the monitor must see that large commands do not
  move the car. A table with a duration of 0 goes on.
- An input is missing for the longest time: a prediction is no better than its model. The line is as
  long as that time, and the next tick with both inputs ends the stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core.actuator import quantise, saturate_rate
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct

if TYPE_CHECKING:
    from firmware_model.law.core import thesis
    from firmware_model.law.layout import Table
    from firmware_model.law.supervision import prediction


class Constants(Struct):
    """Constants."""

    duration: Annotated[float, "tick", "duration of the way to zero; 0: the commands go on"]
    certain: Annotated[float, "tick", "ticks without any effect until a loss of both is certain"]


class State(Struct):
    """State."""

    elapsed: Annotated[float, "tick", "ticks since the start of the way to zero"]


@firmware
def both_lost(table: Table, own: State, told: bool, powerless: float) -> bool:
    """Whether both actuators are lost for certain, and the table asks for a stop.

    Args:
        table: the constant table.
        own: state of this module.
        told: whether the decision tells a loss of the torque, or of both.
        powerless: ticks for which large commands have not moved the car, by the monitor.
    """
    begun = own.elapsed > 0.0
    certain = told and powerless >= table.safe_stop.certain
    lost: bool = table.safe_stop.duration > 0.0 and (begun or certain)
    return lost


@firmware
def is_blind(table: Table, own: prediction.State, complete: bool) -> bool:
    """Whether an input is missing for too long; ``complete``: a tick with both inputs."""
    blind: bool = not complete and own.elapsed >= table.prediction.longest
    return blind


@firmware
def ticks_left(table: Table, own: State, blind_for: float, lost: bool) -> float:
    """The ticks left on the way to zero.

    Args:
        table: the constant table.
        own: changed in place: a tick on, where both are lost.
        blind_for: ticks without an input.
        lost: whether both actuators are lost.
    """
    longest: float = table.prediction.longest
    left = longest - (blind_for - longest)
    if lost:
        left = table.safe_stop.duration - own.elapsed
        own.elapsed += real(1.0, left)
    return left


@firmware
def nearer_to_zero(table: thesis.Table, state: thesis.State, left: float) -> None:
    """A tick on a straight line of both commands to zero, of which so many ticks are ``left``."""
    one = real(1.0, left)
    share = real(0.0, left)
    if left > one:
        share = (left - one) / left
    possible = saturate_rate(table.actuator_1, share * state.command_1, state.command_1)
    state.command_1 = quantise(table.actuator_1, state.actuator_1, possible)
    possible = saturate_rate(table.actuator_2, share * state.command_2, state.command_2)
    state.command_2 = quantise(table.actuator_2, state.actuator_2, possible)
