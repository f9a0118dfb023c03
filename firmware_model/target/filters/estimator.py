"""The fault estimator d̂ = (1 + Q)(G1 u1 + G2 u2 - y) of (2.1): the model of the plant, its bus.

The model gets each command when the plant gets it, ``latency_ticks`` after it was computed, and
whether it was computed or held: an actuator that hears nothing new goes on with what it has.
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.filters import biquad
from firmware_model.target.filters.biquad import advance, output, settle
from firmware_model.target.precision import real
from firmware_model.target.structs import MAX_LATENCY_TICKS, Field, Record

RING = (MAX_LATENCY_TICKS,)

CONSTANTS = (
    Field("channel_1", "y/u1", "G1", biquad.CONSTANTS),
    Field("channel_2", "y/u2", "G2", biquad.CONSTANTS),
    Field("one_plus_q", "1", "1 + Q", biquad.CONSTANTS),
    Field("feedthrough_2", "y/u2", "of G2 to the same tick; 0 with any latency"),
    Field("one_plus_q_feedthrough", "1", "of 1 + Q to the same tick"),
    Field("latency_ticks", "tick", "from a sample until its command acts", "int32"),
)
STATE = (
    Field("channel_1", "y", "state of G1", biquad.STATE),
    Field("channel_2", "y", "state of G2", biquad.STATE),
    Field("one_plus_q", "y", "state of 1 + Q", biquad.STATE),
    Field("delay_1", "u1", "ring of commands on their way to the plant", shape=RING),
    Field("delay_2", "u2", "ring of commands on their way to the plant", shape=RING),
    Field("delay_index", "1", "where the rings hold the command that acts next", "int32"),
    Field("showing_1", "u1", "command 1 as the measurement of this tick begins to show it"),
)  # fmt: skip


@firmware
def model_output(
    constants: Record, state: Record, command_1: float, command_2: float
) -> tuple[float, float]:
    """G1 u1 and G2 u2 as the measurement of this tick shows them, by the model.

    Without latency that is of this tick's commands, otherwise of the ones that act now.
    """
    u1, u2 = command_1, command_2
    if constants.latency_ticks > 0:
        u1 = state.delay_1[state.delay_index]
        u2 = state.delay_2[state.delay_index]
    state.showing_1 = u1
    return (
        output(constants.channel_1, state.channel_1, u1),
        output(constants.channel_2, state.channel_2, u2),
    )


@firmware
def advance_model(constants: Record, state: Record, command_1: float, command_2: float) -> None:
    """Put the commands of this tick on their way; advance the model by those that act."""
    u1, u2 = command_1, command_2
    if constants.latency_ticks > 0:
        index = state.delay_index
        u1 = state.delay_1[index]
        u2 = state.delay_2[index]
        state.delay_1[index] = command_1
        state.delay_2[index] = command_2
        state.delay_index = (index + 1) % constants.latency_ticks
    advance(constants.channel_1, state.channel_1, u1)
    advance(constants.channel_2, state.channel_2, u2)


@firmware
def settle_estimator(constants: Record, state: Record, command_1: float, command_2: float) -> None:
    """The steady state of a healthy plant for constant commands: d̂ = 0."""
    settle(constants.channel_1, state.channel_1, command_1)
    settle(constants.channel_2, state.channel_2, command_2)
    settle(constants.one_plus_q, state.one_plus_q, real(0.0, command_1))
    state.delay_1[:] = command_1
    state.delay_2[:] = command_2
    state.delay_index = 0
    state.showing_1 = command_1


@firmware
def clear_estimator(state: Record) -> None:
    """Empty the filters; the commands that are on their way stay."""
    state.channel_1.accumulators[:] = 0.0
    state.channel_2.accumulators[:] = 0.0
    state.one_plus_q.accumulators[:] = 0.0
