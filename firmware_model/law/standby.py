"""The car is slower than the lowest design: the controller stands by.

A torque hardly moves D* of a slow car, and no model holds there. Both commands go to zero in a
straight line; the decision waits, and a known fault stays known.

The tick that leaves begins from what the car does: every model of the car is in the steady state
that has D* as measured, as the car is that was turned by its driver. C is in the steady state that
asks for the present command, and the error it does not know of fades in as after a missing
measurement: no command jumps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.fault_decision.bumpless_transfer import release
from firmware_model.law.fault_decision.decision import CLEAR, SUSPECTED, transfer_to_losses
from firmware_model.law.fault_decision.likelihood_ratio import start_candidate
from firmware_model.law.fault_decision.mismatch import doubt_motion
from firmware_model.law.fault_decision.other_cars import settle_other_cars
from firmware_model.law.fault_decision.safe_stop import nearer_to_zero
from firmware_model.law.filters.biquad import output, settle
from firmware_model.law.filters.estimator import settle_estimator
from firmware_model.law.filters.prediction import clear_prediction
from firmware_model.law.filters.tracking import settle_tracking
from firmware_model.law.precision import real
from firmware_model.law.reference_shaper import start
from firmware_model.law.structs import Struct

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Table


class State(Struct):
    """State."""

    slow: Annotated[int, "1", "1: the car is slower than the lowest design"]
    elapsed: Annotated[float, "tick", "ticks in standby"]


@firmware
def stands_by(table: Table, own: State, complete: bool) -> bool:
    """Whether the controller stands by; ``complete``: a tick with both inputs."""
    waits: bool = not complete or own.elapsed < table.prediction.longest
    return own.slow > 0 or (own.elapsed > 0.0 and waits)


@firmware
def take_commands_down(table: Table, state: layout.State) -> None:
    """A tick in standby: both commands are nearer to zero."""
    own = state.standby
    nearer_to_zero(table, state, table.prediction.longest - own.elapsed)
    own.elapsed += real(1.0, own.elapsed)


@firmware
def leave(table: Table, state: layout.State, reference: float, y: float) -> None:
    """Begin from the present commands and a car in the steady state of ``y``."""
    torque, force = state.command_1, state.command_2
    zero, one = real(0.0, y), real(1.0, y)
    estimator, own = table.estimator, state.estimator
    rest = settle(estimator.channel_2, own.channel_2, force)
    holding = (y - rest) / settle(estimator.channel_1, own.channel_1, one)
    settle_estimator(estimator, own, holding, force, y)
    own.delay_1[:] = own.dead_1[:] = torque
    settle_other_cars(table, state, holding, force)
    doubt_motion(table.mismatch, state.mismatch, y * y)
    start_candidate(table, state)
    if state.fault_state == SUSPECTED:
        state.fault_state = CLEAR
    settle(table.compensator.filter, state.compensator.filter, zero)
    release(state.bumpless_transfer)
    transfer_to_losses(table, state)
    state.shortfall_1.accumulators[:] = 0.0
    state.shortfall_2.accumulators[:] = 0.0

    error = torque / settle_tracking(table.tracking, state.tracking, one)
    settle_tracking(table.tracking, state.tracking, error)
    start(state.reference_shaper, y)
    clear_prediction(state.prediction)
    tracked = y if table.reference_shaper.enabled else reference
    shown = output(estimator.channel_1, own.channel_1, torque)
    state.prediction.fading = (tracked + shown - y - error) / table.prediction.fading
    state.standby.elapsed = 0.0
