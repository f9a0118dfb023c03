"""The effect of a fault of size 1 on d̂ = G1 u1 + G2 u2 - y, from the onset on.

A torque offset o acts like an additional command and adds -G1 o. A lost force difference adds the
missing part of G2 u2. A biased sensor adds -b to d̂ in the first tick of the bias; no torque makes
such a jump, and the jump distinguishes a bias from a loss. A drift is a ramp. For an unstable plant
M multiplies y, bias and drift.

A new bias or drift would show in the present d̂: if the present tick alone explains more than all
ticks since the old onset, the onset moves to the present tick.

A hypothesis is a row of the table: its fault, the filter that answers to its input, and the limits
of its size.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad, estimator
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.precision import real
from firmware_model.law.status import Verdict
from firmware_model.law.structs import Records, Struct
from firmware_model.law.supervision import candidate, echoes, mismatch
from firmware_model.law.supervision.candidate import count_anew, has_failed, start, take_in
from firmware_model.law.supervision.echoes import ACTUATORS, confesses, missing_command

if TYPE_CHECKING:
    from firmware_model.law.layout import Table


FORCE_LOST, ANOTHER_CAR = int(Verdict.FORCE_LOST), int(Verdict.ANOTHER_CAR)
OFFSET_ROW, FORCE_ROW, BIAS_ROW, DRIFT_ROW, TORQUE_ECHO_ROW, FORCE_ECHO_ROW = 0, 1, 2, 3, 4, 5
ROWS = 6
THROUGH_G1, THROUGH_G2, THROUGH_M = 0, 1, 2
MINUS_ONE, RAMP, COMMAND_2, MISSING = 0, 1, 2, 3
"""Inputs of a row: as of this tick, ticks since the onset, command 2, what an echo misses."""


class Row(Struct):
    """Constants of one hypothesis."""

    fault: Annotated[int, "1", "its Verdict", (1, ANOTHER_CAR)]
    through: Annotated[int, "1", "what answers to its input: 0: G1, 1: G2, 2: M", (0, 2)]
    input: Annotated[int, "1", "0: -1, 1: a ramp, 2: command 2, 3: what the echo misses", (0, 3)]
    echo: Annotated[int, "1", "the actuator of the echo", (0, ACTUATORS - 1)]
    limits: Annotated[candidate.Limits, "1", "limits of its size"]


class Constants(Struct):
    """Constants."""

    candidate: Annotated[candidate.Constants, "1", "thresholds of a restart"]
    n: Annotated[int, "1", "hypotheses in use: those of echoes stand last", (0, ROWS)]
    rows: Annotated[Records[Row], "1", "the hypotheses", (ROWS,)]


class One(Struct):
    """The test of one signature."""

    candidate: Annotated[candidate.State, "1", "fit of the signature to d̂"]
    answer: Annotated[biquad.State, "y", "state of the signature's filter: G1, G2 or M"]
    ramp: Annotated[float, "tick", "minus the ticks since the onset, as of this tick"]


class State(Struct):
    """State."""

    rows: Annotated[Records[One], "1", "the test of each hypothesis", (ROWS,)]
    commanded: Annotated[float, "y²", "Σ (commanded effect of channel 2 on y)²"]
    missing: Annotated[float, "y²", "Σ commanded effect · missing effect in y"]
    before: Annotated[
        float, "1", "evidence of a lost channel 2 from before the onset of the other's loss"
    ]
    jump: Annotated[float, "1", "evidence of the bias in its first tick alone"]
    obeyed: Annotated[int, "1", "1: this tick completes the proof that channel 2 works"]


@firmware
def weigh_signatures(
    table: Table,
    own: State,
    known: mismatch.State,
    heard: echoes.State,
    command_2: float,
    verdict: int,
    innovation: float,
) -> None:
    """Update all candidates with the innovation; restart rejected candidates.

    Args:
        table: the constant table.
        own: changed in place.
        known: of the car, of this tick.
        heard: what the actuators report.
        command_2: command 2 in the measurement of this tick.
        verdict: of the tick before.
        innovation: ν.
    """
    constants, half = table.hypotheses.signatures, real(0.5, innovation)
    fresh = half * innovation * innovation / known.variance
    for i in range(constants.n):
        row, one = constants.rows[i], own.rows[i]
        if not is_informed(row, heard):
            if one.candidate.age > 0.0:
                begin(one)
            continue
        shown = weigh(table, row, one, known, heard, command_2, innovation)
        rejected = has_failed(constants.candidate, one.candidate)
        if i == FORCE_ROW:
            add_missing(own, shown, known.previous_residual)
            rejected = is_over(own, verdict, rejected, -table.decision.suspect)
        if row.through == THROUGH_M:
            rejected = rejected or fresh > one.candidate.evidence
        if rejected and keeps_onset(row, table.echoes, heard):
            count_anew(one.candidate)
            heard.actuators[row.echo].doubted = 1
        elif rejected:
            begin(one)
        if rejected and row.through == THROUGH_M:  # a bias as well as a ramp begins with this tick
            one.ramp = real(-1.0, innovation)
            shown = output(table.estimator.measurement, one.answer, one.ramp)
            take_in(table.mismatch, known, one.candidate, row.limits, shown, innovation)
    bias = own.rows[BIAS_ROW].candidate
    if bias.age == 1.0:  # begun now, or by a verdict in the tick before
        own.jump = bias.evidence


@firmware
def keeps_onset(row: Row, constants: echoes.Constants, heard: echoes.State) -> bool:
    """Whether the onset of a row is sure: a fault that an echo shows, and nobody believes yet."""
    echo = heard.actuators[row.echo]
    unknown = row.input == MISSING and echo.believed == 0
    return unknown and confesses(constants.actuators[row.echo], echo)


@firmware
def keep_before(own: State, test_age: float) -> None:
    """Note the evidence of a lost channel 2 where the candidate for channel 1 begins again."""
    if not test_age > 0.0:
        own.before = own.rows[FORCE_ROW].candidate.evidence


@firmware
def add_missing(own: State, shown: float, residual: float) -> None:
    """Take in how y follows channel 2."""
    own.commanded += shown * shown
    own.missing += shown * residual


@firmware
def is_over(own: State, verdict: int, rejected: bool, limit: float) -> bool:
    """Whether the onset of a lost channel 2 is over: ``rejected``, or the known loss has ended."""
    known = verdict == FORCE_LOST
    works = known and not own.rows[FORCE_ROW].candidate.predicted > limit
    own.obeyed = 0
    if works:
        own.obeyed = 1
    over = works or (not known and rejected)
    if over:
        own.commanded = own.missing = own.before = 0.0
    return over


@firmware
def is_informed(row: Row, heard: echoes.State) -> bool:
    """Whether the input of a row is known: an echo that stays away gives none."""
    return row.input != MISSING or heard.actuators[row.echo].left > 0


@firmware
def input_of(
    row: Row, own: One, constants: echoes.Constants, heard: echoes.State, command_2: float
) -> float:
    """What a fault of size 1 puts into the filter of its row in this tick."""
    put: float = real(-1.0, command_2)
    if row.input == RAMP:
        put = own.ramp
    elif row.input == COMMAND_2:
        put = command_2
    elif row.input == MISSING:
        put = missing_command(constants.actuators[row.echo], heard.actuators[row.echo])
    return put


@firmware
def answer_of(constants: estimator.Constants, row: Row, own: One, put: float) -> float:
    """The answer of the row's filter to ``put``."""
    if row.through == THROUGH_G1:
        return output(constants.channel_1, own.answer, put)
    if row.through == THROUGH_G2:
        return output(constants.channel_2, own.answer, put)
    return output(constants.measurement, own.answer, put)


@firmware
def weigh(
    table: Table,
    row: Row,
    own: One,
    known: mismatch.State,
    heard: echoes.State,
    command_2: float,
    innovation: float,
) -> float:
    """Take in a tick and return the signature in d̂; a believed echo is wrong by minus that."""
    put = input_of(row, own, table.echoes, heard, command_2)
    shown = answer_of(table.estimator, row, own, put)
    limits = row.limits
    if row.input == MISSING and heard.actuators[row.echo].believed == 1:
        limits = table.echoes.wrong
    take_in(table.mismatch, known, own.candidate, limits, shown, innovation)
    return shown


@firmware
def begin(hypothesis: One) -> None:
    """Its onset is now."""
    start(hypothesis.candidate)
    hypothesis.answer.accumulators[:] = 0.0
    hypothesis.ramp = 0.0


@firmware
def begin_all(own: State) -> None:
    """The onset of each is now."""
    begin(own.rows[FORCE_ROW])
    begin_others(own)


@firmware
def begin_others(own: State) -> None:
    """The onset of each but a lost force difference is now; of that fault the evidence is used.

    What an echo misses began when the echo said so.
    """
    for i in range(ROWS):
        if i == FORCE_ROW or i >= TORQUE_ECHO_ROW:
            count_anew(own.rows[i].candidate)
        else:
            begin(own.rows[i])
    forget_sums(own)


@firmware
def forget_sums(own: State) -> None:
    """Forget how y followed channel 2, and the jump of the bias."""
    own.jump = own.commanded = own.missing = own.before = 0.0


@firmware
def answers_no_more(own: State) -> bool:
    """Whether y follows less than half of channel 2's commands since the onset of its loss.

    The test uses d̂ directly: neither another car nor a small sensor error explains so large a d̂.
    """
    gone: bool = own.missing > real(0.5, own.missing) * own.commanded
    return gone


@firmware
def advance_signatures(table: Table, own: State, heard: echoes.State, command_2: float) -> None:
    """A tick on, of which ``command_2`` is in the measurement."""
    for i in range(table.hypotheses.signatures.n):
        row, one = table.hypotheses.signatures.rows[i], own.rows[i]
        if is_informed(row, heard):
            put = input_of(row, one, table.echoes, heard, command_2)
            told = advance_answer(table.estimator, row, one, put)
            if row.input == MISSING:
                heard.actuators[row.echo].told = told
        one.ramp -= real(1.0, command_2)


@firmware
def advance_answer(constants: estimator.Constants, row: Row, own: One, put: float) -> float:
    """Advance the row's filter by ``put``; return its answer to ``put``."""
    if row.through == THROUGH_G1:
        return advance(constants.channel_1, own.answer, put)
    if row.through == THROUGH_G2:
        return advance(constants.channel_2, own.answer, put)
    return advance(constants.measurement, own.answer, put)
