"""What the actuators report, against what they were told.

An echo is an actuator's own report of its output. The law models the output of a healthy actuator
from the commands, so the error

    e = modelled output - echo

is the missing output of the actuator, whatever the fault: lost, late, stuck, oscillating, or
obedient to foreign commands. e adds G e to d̂, a signature with only its share unknown. An echo
alone proves nothing, because an echo may be wrong or repeat the command: the evidence comes from d̂.

Between two echoes e stays. An echo that stays away for long gives no information.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.fault_decision.hypotheses import candidate
from firmware_model.law.filters import whitener
from firmware_model.law.filters.whitener import settle_whitener, whiten
from firmware_model.law.precision import real
from firmware_model.law.structs import FloatArray, RecordArray, Struct

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Table


KEPT_TICKS = 64


class Constants(Struct):
    """Constants."""

    share: Annotated[candidate.Limits, "1", "limits of the share of e in d̂"]
    stage_1: Annotated[whitener.Constants, "1", "actuator 1 from its command to its output"]
    stage_2: Annotated[whitener.Constants, "1", "actuator 2 likewise"]
    own_dead_1: Annotated[int, "tick", "dead time of actuator 1"]
    own_dead_2: Annotated[int, "tick", "dead time of actuator 2"]
    response_1: Annotated[float, "tick", "from a loss of channel 1 until its echo must show it"]
    longest: Annotated[int, "tick", "largest age of an echo that counts"]


class State(Struct):
    """State."""

    stage_1: Annotated[whitener.State, "u1", "state of actuator 1"]
    stage_2: Annotated[whitener.State, "u2", "state of actuator 2"]
    outputs_1: Annotated[FloatArray, "u1", "ring of the modelled output 1", (KEPT_TICKS,)]
    outputs_2: Annotated[FloatArray, "u2", "ring of the modelled output 2", (KEPT_TICKS,)]
    index: Annotated[int, "1", "index of the newest output in the rings"]
    error_1: Annotated[float, "u1", "e of channel 1"]
    error_2: Annotated[float, "u2", "e of channel 2"]
    missing_1: Annotated[float, "u1²", "fading Σ e · output of channel 1 over its echoes"]
    power_1: Annotated[float, "u1²", "fading Σ output² of channel 1 over its echoes"]
    sampled_1: Annotated[float, "tick", "since the sample of the last echo of actuator 1"]
    left_1: Annotated[int, "tick", "for so long the last echo of actuator 1 counts; 0: no echo"]
    left_2: Annotated[int, "tick", "likewise of actuator 2"]


@firmware
def hear(table: Table, state: layout.State, channel: float, echo: float, age_ticks: float) -> None:
    """Take in an echo, before the ``step`` of its tick.

    Args:
        table: the constant table.
        state: changed in place.
        channel: 1 or 2.
        echo: the output of the actuator, in the unit of its command.
        age_ticks: ticks since the sample of the echo; below ``KEPT_TICKS``, or the echo is ignored.
    """
    own, value = state.echoes, real(echo, state.command_1)
    age = real(age_ticks, value)
    if not (math.isfinite(value) and age >= 0.0 and age < real(KEPT_TICKS, value)):
        return
    index = (own.index + KEPT_TICKS - int(age)) % KEPT_TICKS
    if channel == 1.0:
        output, half = own.outputs_1[index], real(0.5, value)
        own.error_1 = output - value
        own.missing_1 = half * own.missing_1 + output * own.error_1
        own.power_1 = half * own.power_1 + output * output
        own.sampled_1 = age
        own.left_1 = table.echoes.longest
    elif channel == 2.0:
        own.error_2 = own.outputs_2[index] - value
        own.left_2 = table.echoes.longest


@firmware
def hear_first(
    tables: RecordArray, states: RecordArray, channel: float, echo: float, age_ticks: float
) -> None:
    """``hear`` for the first of the controllers; see ``controller.step_first``."""
    hear(tables[0], states[0], channel, echo, age_ticks)


@firmware
def advance_echoes(table: Table, state: layout.State) -> None:
    """A tick on: the outputs of the next tick; ``estimator`` is still that of this tick."""
    constants, own, estimator = table.echoes, state.echoes, table.estimator
    if constants.longest == 0:
        return
    memory = state.estimator
    u1, u2 = state.command_1, state.command_2
    if estimator.latency_ticks > 0:
        u1 = memory.delay_1[memory.delay_index]
        u2 = memory.delay_2[memory.delay_index]
    if constants.own_dead_1 > 0:
        dead = estimator.dead_ticks_1
        u1 = memory.dead_1[(memory.dead_index_1 + dead - constants.own_dead_1) % dead]
    if constants.own_dead_2 > 0:
        dead = estimator.dead_ticks_2
        u2 = memory.dead_2[(memory.dead_index_2 + dead - constants.own_dead_2) % dead]
    own.index = (own.index + 1) % KEPT_TICKS
    whiten(constants.stage_1, own.stage_1, u1)
    whiten(constants.stage_2, own.stage_2, u2)
    own.outputs_1[own.index] = next_output(constants.stage_1, own.stage_1)
    own.outputs_2[own.index] = next_output(constants.stage_2, own.stage_2)
    own.left_1, own.error_1 = aged(own.left_1, own.error_1)
    own.left_2, own.error_2 = aged(own.left_2, own.error_2)
    own.sampled_1 += real(1.0, u1)


@firmware
def next_output(stage: whitener.Constants, state: whitener.State) -> float:
    """The output of a stage before its next command arrives."""
    y: float = state.memory[0, 0]
    return y


@firmware
def aged(left: int, error: float) -> tuple[int, float]:
    """``left`` and e a tick later."""
    remaining = max(left - 1, 0)
    still = error if remaining > 0 else real(0.0, error)
    return remaining, still


@firmware
def says_lost(own: State) -> bool:
    """Whether the last echoes miss a quarter of the output of actuator 1."""
    quarter = real(0.25, own.power_1)
    lost: bool = own.left_1 > 0 and own.missing_1 > quarter * own.power_1
    return lost


@firmware
def denies(constants: Constants, own: State, age: float) -> bool:
    """Whether the last echoes deny a loss of channel 1 that is ``age`` ticks old."""
    enough: bool = own.left_1 > 0 and age - own.sampled_1 > constants.response_1
    return enough and not says_lost(own)


@firmware
def settle_echoes(table: Table, state: layout.State) -> None:
    """The actuators have followed the present commands for long; no echo has come."""
    constants, own = table.echoes, state.echoes
    settle_whitener(constants.stage_1, own.stage_1, state.command_1)
    settle_whitener(constants.stage_2, own.stage_2, state.command_2)
    own.outputs_1[:] = state.command_1
    own.outputs_2[:] = state.command_2
    own.left_1 = own.left_2 = 0
    own.missing_1 = own.power_1 = own.sampled_1 = 0.0
    own.error_1 = own.error_2 = 0.0
