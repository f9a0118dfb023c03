"""The fault estimator d̂ = (1 + Q)(G1 u1 + G2 u2 - y) of (2.1): the model of the plant, its bus.

For an unstable plant the models are N1 and N2 of the left-coprime factors, compared with M y
(``discretisation.coprime``); a stable plant has M = 1.

The model gets each command together with the plant, ``latency_ticks`` after the computation. Held
commands count too: an actuator without a new command keeps the last command. A delivered command
then waits for the dead time of the channel plus the dead time of the sensor. Until then a command
is in the queue of its channel.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.structs import MAX_LATENCY_TICKS, MAX_SHOWN_TICKS, FloatArray, Struct


class Constants(Struct):
    """Constants."""

    channel_1: Annotated[biquad.Constants, "y/u1", "G1"]
    channel_2: Annotated[biquad.Constants, "y/u2", "G2"]
    one_plus_q: Annotated[biquad.Constants, "1", "1 + Q"]
    measurement: Annotated[biquad.Constants, "1", "M; no section, for 1, where the plant is stable"]
    feedthrough_2: Annotated[float, "y/u2", "of G2 to the same tick; 0 with latency or dead time"]
    one_plus_q_feedthrough: Annotated[float, "1", "of 1 + Q to the same tick"]
    latency_ticks: Annotated[
        int, "tick", "from a sample until its command is at its actuator", (0, MAX_LATENCY_TICKS)
    ]
    shown_ticks_1: Annotated[
        int, "tick", "from a sample until its command 1 is at G1", (0, MAX_SHOWN_TICKS)
    ]
    shown_ticks_2: Annotated[
        int, "tick", "from a sample until its command 2 is at G2", (0, MAX_SHOWN_TICKS)
    ]


class Queue(Struct):
    """The commands of a channel on their way to its model, a ring."""

    commands: Annotated[FloatArray, "command", "each from a tick", (MAX_SHOWN_TICKS,)]
    index: Annotated[int, "1", "index of the next command at the model"]


class State(Struct):
    """State."""

    channel_1: Annotated[biquad.State, "y", "state of G1"]
    channel_2: Annotated[biquad.State, "y", "state of G2"]
    one_plus_q: Annotated[biquad.State, "y", "state of 1 + Q"]
    measurement: Annotated[biquad.State, "y", "state of M"]
    measured: Annotated[float, "y", "y of this tick, or what stands in for y"]
    queue_1: Annotated[Queue, "u1", "commands 1 on their way to G1"]
    queue_2: Annotated[Queue, "u2", "commands 2 on their way to G2"]
    showing_1: Annotated[float, "u1", "command 1 visible in this tick's measurement"]
    showing_2: Annotated[float, "u2", "command 2 likewise"]


@firmware
def waiting(queue: Queue, ticks: int, waits: int, command: float) -> float:
    """Return the command that has waited for ``waits`` of its ``ticks``; ``command`` for 0."""
    if waits > 0:
        command = queue.commands[(queue.index + ticks - waits) % max(ticks, 1)]
    return command


@firmware
def arriving(queue: Queue, ticks: int, command: float) -> float:
    """Return the command at the model in this tick; without ``ticks`` on its way, ``command``."""
    if ticks > 0:
        command = queue.commands[queue.index]
    return command


@firmware
def pass_on(queue: Queue, ticks: int, command: float) -> float:
    """Queue ``command`` for so many ``ticks``; return the command that leaves the queue."""
    arrived = command
    if ticks > 0:
        arrived = queue.commands[queue.index]
        queue.commands[queue.index] = command
        queue.index = (queue.index + 1) % ticks
    return arrived


@firmware
def model_output(
    constants: Constants, state: State, command_1: float, command_2: float
) -> tuple[float, float]:
    """Return the modelled G1 u1 and G2 u2 in the measurement of this tick.

    Without latency and dead time this tick's commands act, otherwise earlier commands.
    """
    state.showing_1 = arriving(state.queue_1, constants.shown_ticks_1, command_1)
    state.showing_2 = arriving(state.queue_2, constants.shown_ticks_2, command_2)
    y1 = output(constants.channel_1, state.channel_1, state.showing_1)
    y2 = output(constants.channel_2, state.channel_2, state.showing_2)
    return y1, y2


@firmware
def advance_model(constants: Constants, state: State, command_1: float, command_2: float) -> None:
    """Queue the commands of this tick; advance the model by the arriving commands."""
    u1 = pass_on(state.queue_1, constants.shown_ticks_1, command_1)
    u2 = pass_on(state.queue_2, constants.shown_ticks_2, command_2)
    advance(constants.channel_1, state.channel_1, u1)
    advance(constants.channel_2, state.channel_2, u2)


@firmware
def take_measurement(constants: Constants, state: State, measurement: float) -> float:
    """M y of this tick."""
    state.measured = measurement
    shown: float = advance(constants.measurement, state.measurement, measurement)
    return shown
