"""Whose fault is d̂: the hypothesis with the best explanation of d̂.

The evidence of a hypothesis is the log-likelihood ratio of the innovations with and without the
fault, each fault with a private onset. A found fault needs the evidence of a confirmed loss, and
``ahead`` times the evidence of faults elsewhere: torque, force difference or sensor must be far
ahead of both other places, because a loss with an onset error of a few ticks keeps hardly half of
its evidence. With less evidence the verdict is "cannot tell". The verdict names the likeliest fault
at the found place. The verdict stands until another fault is found; the same fault with the
opposite sign ends the verdict. The known sensor errors add up; a small remaining sum ends the
sensor verdict.

A lost torque has a separate test, ``likelihood_ratio``; after confirmation the evidence is the
learnt share in standard deviations from zero. Likewise another car: the evidence belongs to the
direction with the clearest difference. Another car explains d̂ without any fault.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core.biquad import output
from firmware_model.law.precision import real
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import FloatArray, Struct
from firmware_model.law.supervision import candidate, signatures
from firmware_model.law.supervision.candidate import likeliest
from firmware_model.law.supervision.corroboration import sensor_waits, torque_waits
from firmware_model.law.supervision.covariance import LOSS_STATES, variance_of
from firmware_model.law.supervision.echoes import Echo, believe, missing_command, says_lost, works
from firmware_model.law.supervision.frozen import (
    Constants as FrozenConstants,
    State as FrozenState,
    thaw,
    weigh_frozen,
)
from firmware_model.law.supervision.loss_model import known_share
from firmware_model.law.supervision.sensor_error import (
    State as SensorErrorState,
    clear_sensor_error,
    learn_sensor_error,
)
from firmware_model.law.supervision.signatures import (
    Constants as SignaturesConstants,
    State as SignaturesState,
    answers_no_more,
    begin_all,
    begin_others,
    weigh_signatures,
)
from firmware_model.law.supervision.witness import acquits, contradicts, unsure

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Table


CONFIRMED = int(FaultState.CONFIRMED)
NOTHING, CANNOT_BE_TOLD = int(Verdict.NOTHING), int(Verdict.CANNOT_BE_TOLD)
TORQUE_LOST, TORQUE_OFFSET = int(Verdict.TORQUE_LOST), int(Verdict.TORQUE_OFFSET)
FORCE_LOST, BOTH_LOST = int(Verdict.FORCE_LOST), int(Verdict.BOTH_LOST)
SENSOR_WRONG, SENSOR_DRIFTING = int(Verdict.SENSOR_WRONG), int(Verdict.SENSOR_DRIFTING)
SENSOR_FROZEN, ANOTHER_CAR = int(Verdict.SENSOR_FROZEN), int(Verdict.ANOTHER_CAR)
HYPOTHESES = 8  # to ANOTHER_CAR; NOTHING has evidence 0


class Constants(Struct):
    """Constants."""

    signatures: Annotated[
        SignaturesConstants, "1", "of torque offset, lost force and sensor errors"
    ]
    frozen: Annotated[FrozenConstants, "1", "of a frozen sensor"]
    torque_lost: Annotated[candidate.Limits, "1", "limits of the lost or returned share"]
    ahead: Annotated[float, "1", "least ratio of a verdict's evidence to faults at other places"]
    sensor_ahead: Annotated[float, "1", "least ratio for a sensor fault"]
    jump: Annotated[float, "1", "evidence of a bias in its first tick, at least"]
    both_lost: Annotated[
        float, "1", "lead in evidence for a loss of channel 2 after a loss of channel 1"
    ]


class State(Struct):
    """State."""

    signatures: Annotated[SignaturesState, "1", "of torque offset, lost force and sensor errors"]
    frozen: Annotated[FrozenState, "1", "of a frozen sensor"]
    evidence: Annotated[
        FloatArray, "1", "of each hypothesis, by the number of its verdict", (HYPOTHESES,)
    ]
    verdict: Annotated[int, "1", "a Verdict"]
    found: Annotated[int, "1", "fault found in this tick; 0: none"]
    found_size: Annotated[float, "1", "size of a found actuator fault"]
    sensor_error: Annotated[SensorErrorState, "y", "known error of the sensor"]


@firmware
def weigh_hypotheses(table: Table, state: layout.State, innovation: float, expected: float) -> None:
    """Compute the evidence and the verdict of this tick.

    Args:
        table: the constant table.
        state: changed in place; ``mismatch`` and ``sequential_test`` already updated in this tick.
        innovation: innovation of d̂.
        expected: y by the model.
    """
    weigh_signatures(table, state, innovation)
    weigh_frozen(table, state, innovation, expected)
    own = state.hypotheses
    own.evidence[TORQUE_LOST] = torque_evidence(table, state)
    weighed = own.signatures
    own.evidence[TORQUE_OFFSET] = weighed.torque_offset.candidate.evidence
    own.evidence[FORCE_LOST] = weighed.force_lost.candidate.evidence
    if state.echoes.channel_1.left > 0:
        own.evidence[TORQUE_OFFSET] = weighed.torque_echo.candidate.evidence
    if state.echoes.channel_2.left > 0:
        own.evidence[FORCE_LOST] = weighed.force_echo.candidate.evidence
    own.evidence[SENSOR_WRONG] = own.signatures.sensor_biased.candidate.evidence
    own.evidence[SENSOR_DRIFTING] = own.signatures.sensor_drifting.candidate.evidence
    own.evidence[SENSOR_FROZEN] = own.frozen.evidence
    own.evidence[ANOTHER_CAR] = other_car_evidence(table, state)
    judge(table, state)


@firmware
def torque_evidence(table: Table, state: layout.State) -> float:
    """The evidence of a lost torque: from the test, or from the share after confirmation."""
    limits, test = table.hypotheses.torque_lost, state.sequential_test
    half = real(0.5, test.evidence)
    if state.fault_state == CONFIRMED:
        share = known_share(state)
        return half * share * share / variance_of(state.mismatch.covariance, 0)
    share = likeliest(test.correlation, test.information, limits)
    evidence: float = share * (test.correlation - half * share * test.information)
    return evidence


@firmware
def other_car_evidence(table: Table, state: layout.State) -> float:
    """The evidence of the direction with the clearest difference between car and model."""
    mismatch, half = state.mismatch, real(0.5, state.command_1)
    most = real(0.0, half)
    for i in range(LOSS_STATES, LOSS_STATES + table.other_cars.n):
        theta = mismatch.theta[i]
        most = max(most, half * theta * theta / variance_of(mismatch.covariance, i))
    return most


@firmware
def judge(table: Table, state: layout.State) -> None:
    """The verdict of this tick."""
    own, evidence, confirm = state.hypotheses, state.hypotheses.evidence, table.decision.confirm
    lost, was = state.fault_state == CONFIRMED, own.verdict
    own.found = NOTHING
    own.verdict = standing(table, state)
    if own.verdict == NOTHING:
        own.found_size = 0.0
    torque = strongest(evidence, TORQUE_LOST, FORCE_LOST)
    if lost:  # what is tested is its end
        torque = max(state.sequential_test.evidence, evidence[TORQUE_OFFSET])
    excused = is_excused(table, state)
    force, sensor = evidence[FORCE_LOST], of_sensor(table, state, excused)
    apart, world = contradicts(table.witness, state.witness), of_world(table, state, excused)
    actuators = max(torque, force)
    most = max(actuators, sensor)
    second = max(min(torque, force), min(actuators, sensor))
    if lost:
        ahead = force - max(torque, sensor) > table.hypotheses.both_lost
        if ahead and answers_no_more(own.signatures):
            own.verdict = BOTH_LOST
    elif is_reported(own.signatures.force_echo, confirm, most):
        row, echo = own.signatures.force_echo, state.echoes.channel_2
        find_by_echo(table, state, row, echo, FORCE_LOST)
    elif is_reported(own.signatures.torque_echo, confirm, most) and not says_lost(
        table.echoes.actuator_1, state.echoes.channel_1
    ):
        find_by_echo(
            table, state, own.signatures.torque_echo, state.echoes.channel_1, TORQUE_OFFSET
        )
    elif world > confirm and world >= most and not apart:
        own.verdict = ANOTHER_CAR if own.verdict == NOTHING else own.verdict
    elif most > confirm and is_clear(table, state, most, second) and not apart:
        find(table, state, likeliest_fault(evidence, most))
    elif own.verdict == NOTHING and most > confirm:
        own.verdict = CANNOT_BE_TOLD
    elif own.verdict == NOTHING:
        enough = table.decision.suspect if was == ANOTHER_CAR else confirm
        own.verdict = ANOTHER_CAR if evidence[ANOTHER_CAR] > enough else NOTHING
    own.verdict = with_echoes(table, state, own.verdict)


@firmware
def of_sensor(table: Table, state: layout.State, excused: bool) -> float:
    """The most evidence of a fault of the sensor that the witness does not deny."""
    own, none = state.hypotheses, real(0.0, state.command_1)
    most = strongest(own.evidence, SENSOR_WRONG, ANOTHER_CAR)
    if excused:
        most = own.evidence[SENSOR_FROZEN]
    if acquits(table.witness, state.witness):
        most = none
    return most


@firmware
def is_excused(table: Table, state: layout.State) -> bool:
    """Whether the witness denies a bias or drift of the sensor: neither wind nor road jumps."""
    own = state.hypotheses.signatures
    since = state.witness.unbroken
    jumps = own.jump >= table.hypotheses.jump and since < own.sensor_biased.candidate.age
    excused: bool = not jumps and sensor_waits(table, state)
    return excused


@firmware
def of_world(table: Table, state: layout.State, excused: bool) -> float:
    """The most evidence of a fault that its direct witness denies: wind or road looks alike."""
    own, most = state.hypotheses, real(0.0, state.command_1)
    if torque_waits(table, state):
        most = own.evidence[TORQUE_LOST]
    if excused:
        most = max(most, strongest(own.evidence, SENSOR_WRONG, SENSOR_FROZEN))
    return most


@firmware
def with_echoes(table: Table, state: layout.State, verdict: int) -> int:
    """The verdict of a tick, where a believed echo names the place."""
    torque, force = state.echoes.channel_1, state.echoes.channel_2
    if state.fault_state == CONFIRMED:
        gone = force.believed == 1 and says_lost(table.echoes.actuator_2, force)
        verdict = BOTH_LOST if gone else verdict
    elif torque.believed == 1:
        verdict = TORQUE_LOST if says_lost(table.echoes.actuator_1, torque) else TORQUE_OFFSET
    elif force.believed == 1:
        verdict = FORCE_LOST
    return verdict


@firmware
def is_clear(table: Table, state: layout.State, most: float, second: float) -> bool:
    """Whether the fault with the ``most`` evidence is distinguished from faults at other places.

    A bias begins with a jump; no torque can jump. Only d̂ since the onset of a lost channel 1
    distinguishes a lost channel 2 from a lost channel 1: where F̂ works on d̂, u2 answers to every
    d̂, and an earlier d̂ gives no present evidence.
    """
    own, constants = state.hypotheses, table.hypotheses
    if own.evidence[SENSOR_WRONG] == most and own.signatures.jump < constants.jump:
        return False
    ahead: float = constants.ahead
    if strongest(own.evidence, SENSOR_WRONG, ANOTHER_CAR) == most:
        ahead = constants.sensor_ahead
    if own.evidence[FORCE_LOST] == most:
        most = most - own.signatures.before
    clear: bool = most > ahead * second
    return clear


@firmware
def is_reported(own: signatures.One, confirm: float, most: float) -> bool:
    """Whether the echo of an actuator explains d̂ at least half as well as any other fault.

    The echo would have to be wrong at the same time as another fault, and in the same way.
    """
    evidence, half = own.candidate.evidence, real(0.5, most)
    reported: bool = evidence > confirm and evidence > half * most
    return reported


@firmware
def find_by_echo(
    table: Table, state: layout.State, own: signatures.One, echo: Echo, fault: int
) -> None:
    """Record that ``echo`` tells the truth about a ``fault``, or no longer does."""
    believe(table, state, echo, own.candidate, own.answer)
    hypotheses = state.hypotheses
    begin_all(hypotheses.signatures)
    hypotheses.found_size = 0.0
    hypotheses.found = fault
    hypotheses.verdict = NOTHING


@firmware
def believe_with_witness(table: Table, state: layout.State) -> None:
    """Believe the echo of a lost torque without the sensor, once the witness shows the loss too."""
    echo, row, off = state.echoes.channel_1, state.hypotheses.signatures.torque_echo, state.witness
    actuator = table.echoes.actuator_1
    missing = output(table.estimator.channel_1, row.answer, missing_command(actuator, echo))
    half = real(0.5, missing)
    explains = abs(off.difference + missing) < half * abs(off.difference)
    shown = off.left > 0 and off.witness_off > unsure(table.witness, off)
    if shown and explains and echo.believed == 0 and says_lost(actuator, echo):
        find_by_echo(table, state, row, echo, TORQUE_OFFSET)


@firmware
def standing(table: Table, state: layout.State) -> int:
    """The standing verdict of the last tick, without a new finding."""
    own = state.hypotheses
    verdict: int = own.verdict
    if state.fault_state == CONFIRMED:
        if verdict != BOTH_LOST:
            verdict = CANNOT_BE_TOLD
            if own.evidence[TORQUE_LOST] > table.decision.confirm:
                verdict = TORQUE_LOST
        return verdict
    if verdict == SENSOR_FROZEN and own.frozen.repetitions > real(0.0, own.found_size):
        return verdict
    working = table.echoes.working
    if verdict == TORQUE_OFFSET and works(state.echoes.channel_1, working):
        verdict = NOTHING
    obeys = own.signatures.obeyed == 1 or works(state.echoes.channel_2, working)
    if verdict == FORCE_LOST and obeys:
        verdict = NOTHING
    if verdict == TORQUE_LOST or verdict > SENSOR_DRIFTING:
        verdict = NOTHING
    return verdict


@firmware
def strongest(evidence: FloatArray, first: int, end: int) -> float:
    """The most evidence of a fault from ``first`` on, before ``end``."""
    most: float = evidence[first]
    for i in range(first + 1, end):
        most = max(most, evidence[i])
    return most


@firmware
def likeliest_fault(evidence: FloatArray, most: float) -> int:
    """The fault with the evidence ``most``; the first fault among equals."""
    fault = ANOTHER_CAR
    for i in range(1, ANOTHER_CAR):
        last = ANOTHER_CAR - i
        if evidence[last] == most:
            fault = last
    return fault


@firmware
def find(table: Table, state: layout.State, fault: int) -> None:
    """Record a found ``fault``: the fault is present, or an earlier fault is gone.

    The weighed evidence is now known, so every candidate starts with a new onset.
    """
    own, weighed = state.hypotheses, state.hypotheses.signatures
    size = size_of(weighed, fault)
    if fault == SENSOR_WRONG:
        gone = learn_sensor_error(table, state, weighed.sensor_biased, real(-1.0, size))
    elif fault == SENSOR_DRIFTING:
        gone = learn_sensor_error(table, state, weighed.sensor_drifting, weighed.ramp)
    else:
        opposite = own.found_size * size < real(0.0, size)
        gone = opposite and place_of(fault) == place_of(own.verdict)
    if fault == FORCE_LOST:
        begin_others(weighed)
    elif fault != TORQUE_LOST:
        begin_all(weighed)
    own.found_size = size
    own.found = fault
    own.verdict = NOTHING if gone else fault


@firmware
def place_of(fault: int) -> int:
    """The first fault of the place where ``fault`` is: torque, force difference or sensor."""
    if fault < FORCE_LOST:
        return TORQUE_LOST
    return min(fault, SENSOR_WRONG)


@firmware
def found_elsewhere(own: State) -> bool:
    """Whether this tick found the begin or the end of a fault outside the torque."""
    elsewhere: bool = place_of(own.found) != TORQUE_LOST
    return elsewhere


@firmware
def size_of(own: signatures.State, fault: int) -> float:
    """The size of a found actuator fault; 0 for other faults."""
    size = real(0.0, own.ramp)
    if fault == TORQUE_OFFSET:
        size = own.torque_offset.candidate.size_now
    elif fault == FORCE_LOST:
        size = own.force_lost.candidate.size_now
    return size


@firmware
def clear_hypotheses(state: layout.State) -> None:
    """Nothing is known."""
    own = state.hypotheses
    begin_all(own.signatures)
    thaw(own.frozen)
    own.frozen.measurement = own.frozen.expected = own.found_size = 0.0
    own.evidence[:] = 0.0
    clear_sensor_error(own.sensor_error)
    own.verdict = own.found = NOTHING
