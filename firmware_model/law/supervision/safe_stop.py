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
from firmware_model.law.core.actuator import command_possible
from firmware_model.law.precision import real
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import Struct

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Table


BOTH_LOST, CONFIRMED = int(Verdict.BOTH_LOST), int(FaultState.CONFIRMED)


class Constants(Struct):
    """Constants."""

    duration: Annotated[float, "tick", "duration of the way to zero; 0: the commands go on"]
    certain: Annotated[float, "tick", "ticks without any effect until a loss of both is certain"]


class State(Struct):
    """State."""

    elapsed: Annotated[float, "tick", "ticks since the start of the way to zero"]


@firmware
def both_lost(table: Table, state: layout.State) -> bool:
    """Whether both actuators are lost for certain, and the table asks for a stop."""
    begun = state.safe_stop.elapsed > 0.0
    told = state.fault_state == CONFIRMED or state.hypotheses.verdict == BOTH_LOST
    certain = told and state.monitor.powerless >= table.safe_stop.certain
    lost: bool = table.safe_stop.duration > 0.0 and (begun or certain)
    return lost


@firmware
def stops(table: Table, state: layout.State, complete: bool) -> bool:
    """Whether the commands have to go; ``complete``: a tick with both inputs."""
    blind: bool = not complete and state.prediction.elapsed >= table.prediction.longest
    return blind or both_lost(table, state)


@firmware
def take_commands_back(table: Table, state: layout.State) -> None:
    """A tick nearer to zero."""
    own, one, longest = state.safe_stop, real(1.0, state.command_1), table.prediction.longest
    left = longest - (state.prediction.elapsed - longest)
    if both_lost(table, state):
        state.hypotheses.verdict = BOTH_LOST
        left = table.safe_stop.duration - own.elapsed
        own.elapsed += one
    nearer_to_zero(table, state, left)


@firmware
def nearer_to_zero(table: Table, state: layout.State, left: float) -> None:
    """A tick on the straight line to zero, of which so many ticks are ``left``."""
    one = real(1.0, state.command_1)
    share = real(0.0, one)
    if left > one:
        share = (left - one) / left
    command_possible(table, state, share * state.command_1, share * state.command_2)
