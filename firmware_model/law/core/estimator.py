"""The fault estimator d̂ = (1 + Q)(G1 u1 + G2 u2 - y) of (2.1): the model of the plant, its bus.

For an unstable plant the models are N1 and N2 of the left-coprime factors, compared with M y
(``discretisation.coprime``); a stable plant has M = 1.

The model gets each command together with the plant, ``latency_ticks`` after the computation. Held
commands count too: an actuator without a new command keeps the last command. A delivered command
then waits for the dead time of the channel plus the dead time of the sensor.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output, settle
from firmware_model.law.precision import real
from firmware_model.law.structs import MAX_LATENCY_TICKS, MAX_SHOWN_TICKS, FloatArray, Struct

RING = (MAX_LATENCY_TICKS,)


class Constants(Struct):
    """Constants."""

    channel_1: Annotated[biquad.Constants, "y/u1", "G1"]
    channel_2: Annotated[biquad.Constants, "y/u2", "G2"]
    one_plus_q: Annotated[biquad.Constants, "1", "1 + Q"]
    measurement: Annotated[biquad.Constants, "1", "M; no section, for 1, where the plant is stable"]
    feedthrough_2: Annotated[
        float, "y/u2", "of G2 to the same tick; 0 with any latency or dead time"
    ]
    one_plus_q_feedthrough: Annotated[float, "1", "of 1 + Q to the same tick"]
    latency_ticks: Annotated[
        int, "tick", "from a sample until its command is at its actuator", (0, MAX_LATENCY_TICKS)
    ]
    dead_ticks_1: Annotated[
        int, "tick", "dead time of channel 1, from there until G1", (0, MAX_LATENCY_TICKS)
    ]
    dead_ticks_2: Annotated[
        int, "tick", "dead time of channel 2, from there until G2", (0, MAX_LATENCY_TICKS)
    ]
    shown_ticks_1: Annotated[
        int, "tick", "from a sample until its command 1 is at G1", (0, MAX_SHOWN_TICKS)
    ]
    shown_ticks_2: Annotated[
        int, "tick", "from a sample until its command 2 is at G2", (0, MAX_SHOWN_TICKS)
    ]


class State(Struct):
    """State."""

    channel_1: Annotated[biquad.State, "y", "state of G1"]
    channel_2: Annotated[biquad.State, "y", "state of G2"]
    one_plus_q: Annotated[biquad.State, "y", "state of 1 + Q"]
    measurement: Annotated[biquad.State, "y", "state of M"]
    measured: Annotated[float, "y", "y of this tick, or what stands in for y"]
    delay_1: Annotated[FloatArray, "u1", "ring of commands on their way to the plant", RING]
    delay_2: Annotated[FloatArray, "u2", "ring of commands on their way to the plant", RING]
    delay_index: Annotated[int, "1", "index of the next acting command in the rings"]
    dead_1: Annotated[FloatArray, "u1", "ring of commands in the dead time of channel 1", RING]
    dead_2: Annotated[FloatArray, "u2", "ring of commands in the dead time of channel 2", RING]
    dead_index_1: Annotated[int, "1", "index of G1's next command in the ring"]
    dead_index_2: Annotated[int, "1", "index of G2's next command in the ring"]
    showing_1: Annotated[float, "u1", "command 1 visible in this tick's measurement"]
    showing_2: Annotated[float, "u2", "command 2 likewise"]
    shown_index_1: Annotated[int, "1", "index of the next visible output in the rings of G1"]
    shown_index_2: Annotated[int, "1", "index of the next visible output in the rings of G2"]


@firmware
def model_output(
    constants: Constants, state: State, command_1: float, command_2: float
) -> tuple[float, float]:
    """Return the modelled G1 u1 and G2 u2 in the measurement of this tick.

    Without latency and dead time this tick's commands act, otherwise earlier commands.
    """
    u1, u2 = command_1, command_2
    if constants.latency_ticks > 0:
        u1 = state.delay_1[state.delay_index]
        u2 = state.delay_2[state.delay_index]
    if constants.dead_ticks_1 > 0:
        u1 = state.dead_1[state.dead_index_1]
    if constants.dead_ticks_2 > 0:
        u2 = state.dead_2[state.dead_index_2]
    state.showing_1, state.showing_2 = u1, u2
    y1 = output(constants.channel_1, state.channel_1, u1)
    y2 = output(constants.channel_2, state.channel_2, u2)
    return y1, y2


@firmware
def advance_model(constants: Constants, state: State, command_1: float, command_2: float) -> None:
    """Queue the commands of this tick; advance the model by the acting commands."""
    u1, u2 = command_1, command_2
    if constants.latency_ticks > 0:
        index = state.delay_index
        u1 = state.delay_1[index]
        u2 = state.delay_2[index]
        state.delay_1[index] = command_1
        state.delay_2[index] = command_2
        state.delay_index = (index + 1) % constants.latency_ticks
    if constants.dead_ticks_1 > 0:
        index = state.dead_index_1
        arrived = u1
        u1 = state.dead_1[index]
        state.dead_1[index] = arrived
        state.dead_index_1 = (index + 1) % constants.dead_ticks_1
    if constants.dead_ticks_2 > 0:
        index = state.dead_index_2
        arrived = u2
        u2 = state.dead_2[index]
        state.dead_2[index] = arrived
        state.dead_index_2 = (index + 1) % constants.dead_ticks_2
    if constants.shown_ticks_1 > 0:
        state.shown_index_1 = (state.shown_index_1 + 1) % constants.shown_ticks_1
    if constants.shown_ticks_2 > 0:
        state.shown_index_2 = (state.shown_index_2 + 1) % constants.shown_ticks_2
    advance(constants.channel_1, state.channel_1, u1)
    advance(constants.channel_2, state.channel_2, u2)


@firmware
def take_measurement(constants: Constants, state: State, measurement: float) -> float:
    """M y of this tick."""
    state.measured = measurement
    shown: float = advance(constants.measurement, state.measurement, measurement)
    return shown


@firmware
def settle_estimator(
    constants: Constants, state: State, command_1: float, command_2: float, level: float
) -> None:
    """The steady state of a healthy plant for constant commands: d̂ = 0.

    ``level`` is y of an integrating plant: with zero commands the plant rests at any y.
    """
    shown = settle(constants.channel_1, state.channel_1, command_1)
    shown += settle(constants.channel_2, state.channel_2, command_2)
    settle(constants.one_plus_q, state.one_plus_q, real(0.0, command_1))
    for_one = settle(constants.measurement, state.measurement, real(1.0, command_1))
    if for_one != 0.0:
        level = shown / for_one
    state.measured = level
    settle(constants.measurement, state.measurement, level)
    state.delay_1[:] = command_1
    state.delay_2[:] = command_2
    state.delay_index = 0
    state.dead_1[:] = command_1
    state.dead_2[:] = command_2
    state.dead_index_1 = 0
    state.dead_index_2 = 0
    state.showing_1, state.showing_2 = command_1, command_2
    state.shown_index_1 = 0
    state.shown_index_2 = 0


@firmware
def clear_estimator(state: State) -> None:
    """Empty the filters; queued commands stay."""
    state.channel_1.accumulators[:] = 0.0
    state.channel_2.accumulators[:] = 0.0
    state.one_plus_q.accumulators[:] = 0.0
    state.measurement.accumulators[:] = 0.0


@firmware
def pending_command(constants: Constants, state: State, i: int) -> float:
    """The ``i``-th of the ``shown_ticks_1`` commands 1 on their way to G1, the next one first."""
    dead, latency = constants.dead_ticks_1, max(constants.latency_ticks, 1)
    if i < dead:
        command: float = state.dead_1[(state.dead_index_1 + i) % dead]
    else:
        command = state.delay_1[(state.delay_index + i - dead) % latency]
    return command
