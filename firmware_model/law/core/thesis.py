"""The thesis's law, equation by equation.

    u1 = C (r - y)                        (3.32)   command_torque
    d̂  = (1 + Q) (G1 u1 + G2 u2 - y)      (2.1)    command_torque, command_force
    u2 = r2 + F̂ d̂                         (2.37)   command_force

For an unstable plant read N1, N2 and M y in place of G1, G2 and y (``estimator``).

A command is first saturated in rate and magnitude and rounded to the resolution of its frame; the
estimator works on the resulting value.

``run_alone`` runs the three equations without a supervision. A supervised controller decides
between the two commands whether a channel is lost, and F̂ may work on the known loss in place of d̂.
"""

from __future__ import annotations

import math
from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law import status
from firmware_model.law.core import (
    actuator,
    compensator,
    estimator,
    reference_shaper,
    shortfall,
    tracking,
)
from firmware_model.law.core.actuator import quantise, saturate_rate
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.core.estimator import advance_model, model_output, take_measurement
from firmware_model.law.core.reference_shaper import tracked_reference
from firmware_model.law.core.shortfall import make_up
from firmware_model.law.core.tracking import asked_torque, missing_output, track
from firmware_model.law.precision import real
from firmware_model.law.status import Mode
from firmware_model.law.structs import Struct

MODE_RUN, MODE_BLIND = int(Mode.RUN), int(Mode.BLIND)


class Tick(Struct):
    """What the stages of a tick hand on."""

    asked_1: Annotated[float, "u1", "C (r - y)"]
    possible_1: Annotated[float, "u1", "with the make-up, within the limits of channel 1"]
    model_1: Annotated[float, "y", "G1 u1"]
    model_2: Annotated[float, "y", "G2 u2, as the commands before this tick leave it"]
    residual: Annotated[float, "y", "G1 u1 + G2 u2 - y, likewise"]
    asked_2: Annotated[float, "u2", "r2 + F̂ d̂"]
    possible_2: Annotated[float, "u2", "with the make-up, within the limits of channel 2"]
    overflows: Annotated[int, "1", "1: a command is no finite number"]


class Table(Struct):
    """The constants of the thesis's law."""

    supervised: Annotated[int, "1", "0: the thesis's law alone", (0, 1)]
    reference_shaper: Annotated[reference_shaper.Constants, "1", "limits r̈"]
    tracking: Annotated[tracking.Constants, "1", "C"]
    estimator: Annotated[estimator.Constants, "1", "F1 and 1 + Q"]
    compensator: Annotated[compensator.Constants, "1", "F̂"]
    actuator_1: Annotated[actuator.Constants, "1", "what channel 1 can follow"]
    actuator_2: Annotated[actuator.Constants, "1", "what channel 2 can follow"]
    shortfall_1: Annotated[shortfall.Constants, "1", "make-up of channel 1"]
    shortfall_2: Annotated[shortfall.Constants, "1", "make-up of channel 2"]


class State(status.State):
    """The memory of the thesis's law."""

    tick: Annotated[Tick, "1", "what the stages of a tick hand on"]
    reference_shaper: Annotated[reference_shaper.State, "1", "reference of C"]
    tracking: Annotated[tracking.State, "1", "C"]
    estimator: Annotated[estimator.State, "1", "F1 and 1 + Q"]
    compensator: Annotated[compensator.State, "1", "F̂"]
    actuator_1: Annotated[actuator.State, "1", "rounding of command 1"]
    actuator_2: Annotated[actuator.State, "1", "rounding of command 2"]
    shortfall_1: Annotated[shortfall.State, "1", "what channel 1 could not do"]
    shortfall_2: Annotated[shortfall.State, "1", "what channel 2 could not do"]


@firmware
def begin_tick(table: Table, state: State) -> None:
    """Compute the outputs of the models before the commands of this tick."""
    tick, zero = state.tick, real(0.0, state.command_1)
    model_1, model_2 = model_output(table.estimator, state.estimator, zero, state.command_2)
    tick.model_1 = model_1
    tick.model_2 = model_2


@firmware
def command_torque(table: Table, state: State, tracked: float, seen: float, y: float) -> None:
    """Command 1, u1 = C (r - y) (3.32), and what F1 makes of ``y``.

    Args:
        table: the constant table.
        state: after ``begin_tick``; changed in place.
        tracked: r of C, of the reference shaper.
        seen: y of C.
        y: y of F1.
    """
    tick, tracking, feedback = state.tick, table.tracking, table.tracking.feedback
    estimator, zero = table.estimator, real(0.0, tracked)
    wanted = tracked - feedback * seen
    tick.asked_1 = asked_torque(tracking, state.tracking, wanted + feedback * tick.model_1)
    made_up = make_up(table.shortfall_1, estimator.channel_1, table.actuator_1, state.shortfall_1)
    wish = tick.asked_1 + made_up
    tick.overflows = 0 if math.isfinite(wish) else 1
    tick.possible_1 = saturate_rate(table.actuator_1, wish, state.command_1)
    state.command_1 = quantise(table.actuator_1, state.actuator_1, tick.possible_1)
    model_1, model_2 = model_output(estimator, state.estimator, state.command_1, zero)
    track(tracking, state.tracking, wanted + feedback * model_1, state.command_1)
    tick.model_1 = model_1
    tick.model_2 = model_2
    tick.residual = model_1 + model_2 - take_measurement(estimator, state.estimator, y)


@firmware
def command_force(table: Table, state: State, r: float, loss: float) -> float:
    """Command 2, u2 = r2 + F̂ d̂ (2.37), or F̂ of the known ``loss``; return d̂ (2.1)."""
    tick, estimator, compensator = state.tick, table.estimator, table.compensator
    zero = real(0.0, r)
    force = compensator.reference_share * r
    force += output(compensator.filter, state.compensator.filter, zero)
    made_up = make_up(table.shortfall_2, estimator.channel_2, table.actuator_2, state.shortfall_2)
    if compensator.on_confirmation > 0:
        force = force + compensator.feedthrough * loss
    else:  # u2 is part of d̂: u2 = r2 + rest + f (q_rest + q (residual + g u2)), solved for u2
        estimate = output(estimator.one_plus_q, state.estimator.one_plus_q, zero)
        estimate += estimator.one_plus_q_feedthrough * tick.residual
        force = (force + compensator.feedthrough * estimate) * compensator.loop_inverse
        made_up = made_up * compensator.loop_inverse
    wish = force + made_up
    if not math.isfinite(wish):
        tick.overflows = 1
    tick.asked_2 = force
    tick.possible_2 = saturate_rate(table.actuator_2, wish, state.command_2)
    state.command_2 = quantise(table.actuator_2, state.actuator_2, tick.possible_2)
    residual = tick.residual + estimator.feedthrough_2 * state.command_2
    d_hat: float = advance(estimator.one_plus_q, state.estimator.one_plus_q, residual)
    drive = loss if compensator.on_confirmation > 0 else d_hat
    advance(compensator.filter, state.compensator.filter, drive)
    return d_hat


@firmware
def end_tick(table: Table, state: State, short_1: float, short_2: float) -> None:
    """Advance the models by the commands of this tick, each ``short`` of the asked command."""
    constants, counts = table.estimator, table.tracking.excuses_limits
    advance(constants.channel_1, state.shortfall_1, short_1 * counts)
    missing = advance(constants.channel_2, state.shortfall_2, short_2 * counts)
    if constants.shown_ticks_2 > 0:
        state.tracking.delay[state.estimator.queue_2.index] = missing
    advance_model(table.estimator, state.estimator, state.command_1, state.command_2)


@firmware
def run_alone(table: Table, state: State, r: float, y: float) -> None:
    """A tick without any supervision; a missing input keeps its last value."""
    told, tick = math.isfinite(r) and math.isfinite(y), state.tick
    held_1, held_2 = state.command_1, state.command_2
    if math.isfinite(r):
        state.reference = r
    if math.isfinite(y):
        state.measurement = y
    begin_tick(table, state)
    seen = missing_output(table.estimator, state.tracking, state.estimator, state.shortfall_2)
    seen += state.measurement
    tracked = tracked_reference(table.reference_shaper, state.reference_shaper, state.reference)
    command_torque(table, state, tracked, seen, state.measurement)
    none = real(0.0, held_1)
    state.fault_estimate = command_force(table, state, state.reference, none)
    state.mode = MODE_RUN if told else MODE_BLIND
    if tick.overflows == 1:
        state.command_1, state.command_2 = held_1, held_2
        state.mode = MODE_BLIND
    end_tick(table, state, tick.asked_1 - tick.possible_1, tick.asked_2 - tick.possible_2)
