"""The effect of a fault of size 1 on d̂ = G1 u1 + G2 u2 - y, from the onset on.

A torque offset o acts like an additional command and adds -G1 o. A lost force difference adds the
missing part of G2 u2. A biased sensor adds -b to d̂ in the first tick of the bias; no torque makes
such a jump, and the jump distinguishes a bias from a loss. A drift is a ramp. For an unstable plant
M multiplies y, bias and drift.

A new bias or drift would show in the present d̂: if the present tick alone explains more than all
ticks since the old onset, the onset moves to the present tick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.precision import real
from firmware_model.law.status import Verdict
from firmware_model.law.structs import Struct
from firmware_model.law.supervision.candidate import (
    Constants as CandidateConstants,
    Limits as CandidateLimits,
    State as CandidateState,
    count_anew,
    has_failed,
    start,
    take_in,
)
from firmware_model.law.supervision.echoes import Actuator, Echo, missing_command

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Table


FORCE_LOST = int(Verdict.FORCE_LOST)


class Constants(Struct):
    """Constants."""

    candidate: Annotated[CandidateConstants, "1", "thresholds of a restart"]
    torque_offset: Annotated[CandidateLimits, "u1", "limits of its size"]
    force_lost: Annotated[CandidateLimits, "1", "limits of the lost share"]
    sensor_biased: Annotated[CandidateLimits, "y", "limits of its size"]
    sensor_drifting: Annotated[CandidateLimits, "y/tick", "limits of its size"]


class One(Struct):
    """The test of one signature."""

    candidate: Annotated[CandidateState, "1", "fit of the signature to d̂"]
    answer: Annotated[biquad.State, "y", "state of the signature's filter: G1, G2 or M"]


class State(Struct):
    """State."""

    torque_offset: Annotated[One, "u1", "an offset of the torque"]
    force_lost: Annotated[One, "1", "loss of channel 2"]
    sensor_biased: Annotated[One, "y", "a bias of the sensor"]
    sensor_drifting: Annotated[One, "y/tick", "a drift of the sensor"]
    torque_echo: Annotated[One, "1", "the error of the echo of actuator 1"]
    force_echo: Annotated[One, "1", "the error of the echo of actuator 2"]
    ramp: Annotated[float, "tick", "the drift of 1/tick as of this tick"]
    commanded: Annotated[float, "y²", "Σ (commanded effect of channel 2 on y)²"]
    missing: Annotated[float, "y²", "Σ commanded effect · missing effect in y"]
    before: Annotated[
        float, "1", "evidence of a lost channel 2 from before the onset of the other's loss"
    ]
    jump: Annotated[float, "1", "evidence of the bias in its first tick alone"]
    obeyed: Annotated[int, "1", "1: this tick completes the proof that channel 2 works"]


@firmware
def weigh_signatures(table: Table, state: layout.State, innovation: float) -> None:
    """Update all candidates with the innovation; restart rejected candidates."""
    constants, own = table.hypotheses.signatures, state.hypotheses.signatures
    g1, g2, m = table.estimator.channel_1, table.estimator.channel_2, table.estimator.measurement
    one = real(1.0, innovation)
    offset, force = own.torque_offset, own.force_lost
    shown = output(g1, offset.answer, -one)
    take_in(table, state, offset.candidate, constants.torque_offset, shown, innovation)
    if has_failed(constants.candidate, offset.candidate):
        begin(offset)
    shown = output(g2, force.answer, state.other_cars.command_2)
    take_in(table, state, force.candidate, constants.force_lost, shown, innovation)
    own.commanded += shown * shown
    own.missing += shown * state.mismatch.previous_residual
    known, limit = state.hypotheses.verdict == FORCE_LOST, -table.decision.suspect
    works = known and not force.candidate.foretold > limit
    own.obeyed = 0
    if works:
        own.obeyed = 1
    if works or (not known and has_failed(constants.candidate, force.candidate)):
        begin(force)
        own.commanded = own.missing = own.before = 0.0
    if not state.sequential_test.age > real(0.0, one):  # the candidate for channel 1 begins again
        own.before = force.candidate.evidence
    echoes, told = state.echoes, table.echoes
    weigh_echo(table, state, own.torque_echo, g1, told.actuator_1, echoes.channel_1, innovation)
    weigh_echo(table, state, own.force_echo, g2, told.actuator_2, echoes.channel_2, innovation)
    half = real(0.5, innovation)
    fresh = half * innovation * innovation / state.mismatch.variance
    bias, drift = own.sensor_biased, own.sensor_drifting
    shown = output(m, bias.answer, -one)
    take_in(table, state, bias.candidate, constants.sensor_biased, shown, innovation)
    if fresh > bias.candidate.evidence or has_failed(constants.candidate, bias.candidate):
        begin(bias)
        shown = output(m, bias.answer, -one)
        take_in(table, state, bias.candidate, constants.sensor_biased, shown, innovation)
    if bias.candidate.age == one:  # begun now, or by a verdict in the tick before
        own.jump = bias.candidate.evidence
    shown = output(m, drift.answer, own.ramp)
    take_in(table, state, drift.candidate, constants.sensor_drifting, shown, innovation)
    if fresh > drift.candidate.evidence or has_failed(constants.candidate, drift.candidate):
        begin(drift)
        own.ramp = -one
        shown = output(m, drift.answer, own.ramp)
        take_in(table, state, drift.candidate, constants.sensor_drifting, shown, innovation)


@firmware
def weigh_echo(
    table: Table,
    state: layout.State,
    own: One,
    channel: biquad.Constants,
    actuator: Actuator,
    echo: Echo,
    innovation: float,
) -> None:
    """Weigh the missing output that ``echo`` reports; without an echo no evidence stays."""
    if echo.left > 0:
        shown = output(channel, own.answer, missing_command(actuator, echo))
        if echo.believed == 1:
            take_in(table, state, own.candidate, table.echoes.wrong, shown, innovation)
        else:
            take_in(table, state, own.candidate, table.echoes.share, shown, innovation)
        if has_failed(table.hypotheses.signatures.candidate, own.candidate):
            begin(own)
    elif own.candidate.age > 0.0:
        begin(own)


@firmware
def begin(hypothesis: One) -> None:
    """Its onset is now."""
    start(hypothesis.candidate)
    hypothesis.answer.accumulators[:] = 0.0


@firmware
def begin_all(state: State) -> None:
    """The onset of each is now."""
    begin(state.force_lost)
    begin_others(state)


@firmware
def begin_others(state: State) -> None:
    """The onset of each but a lost force difference is now; of that fault the evidence is used."""
    count_anew(state.force_lost.candidate)
    begin(state.torque_offset)
    begin(state.torque_echo)
    begin(state.force_echo)
    begin(state.sensor_biased)
    begin(state.sensor_drifting)
    state.ramp = state.jump = state.commanded = state.missing = state.before = 0.0


@firmware
def answers_no_more(state: State) -> bool:
    """Whether y follows less than half of channel 2's commands since the onset of its loss.

    The test uses d̂ directly: neither another car nor a small sensor error explains so large a d̂.
    """
    gone: bool = state.missing > real(0.5, state.missing) * state.commanded
    return gone


@firmware
def advance_signatures(table: Table, state: layout.State) -> None:
    """A tick on; ``other_cars`` has the command 2 of it."""
    own, estimator = state.hypotheses.signatures, table.estimator
    one = real(1.0, own.ramp)
    advance(estimator.channel_1, own.torque_offset.answer, -one)
    advance(estimator.channel_2, own.force_lost.answer, state.other_cars.command_2)
    echoes = state.echoes
    if echoes.channel_1.left > 0:
        missing = missing_command(table.echoes.actuator_1, echoes.channel_1)
        advance(estimator.channel_1, own.torque_echo.answer, missing)
    if echoes.channel_2.left > 0:
        missing = missing_command(table.echoes.actuator_2, echoes.channel_2)
        advance(estimator.channel_2, own.force_echo.answer, missing)
    advance(estimator.measurement, own.sensor_biased.answer, -one)
    advance(estimator.measurement, own.sensor_drifting.answer, own.ramp)
    own.ramp -= one
