"""Whose fault is d̂: the hypothesis with the best explanation of d̂.

The evidence of a hypothesis is the log-likelihood ratio of the innovations with and without the
fault, each fault with a private onset. A found fault needs the evidence of a confirmed loss, and
``ahead`` times the evidence of faults elsewhere: torque, force difference or sensor must be far
ahead of both other places, because a loss with an onset error of a few ticks keeps hardly half of
its evidence. With less evidence the verdict is "cannot tell". The verdict names the likeliest fault
at the found place. The verdict stands until another fault is found; the same fault with the
opposite sign ends the verdict. The known sensor errors add up; a small remaining sum ends the
sensor verdict.

``likelihood_ratio`` sets the onset of a lost torque; after confirmation the evidence is the learnt
share in standard deviations from zero. Likewise another car: the evidence belongs to the
direction with the clearest difference. Another car explains d̂ without any fault.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core.biquad import output
from firmware_model.law.precision import real
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import FloatArray, Struct
from firmware_model.law.supervision import candidate, echoes, mismatch, signatures, witness
from firmware_model.law.supervision.corroboration import sensor_waits
from firmware_model.law.supervision.covariance import LOSS_STATES, SHARE, variance_of
from firmware_model.law.supervision.echoes import (
    FORCE,
    TORQUE,
    believe,
    missing_command,
    says_lost,
    shows,
    works,
)
from firmware_model.law.supervision.frozen import (
    Constants as FrozenConstants,
    State as FrozenState,
    thaw,
)
from firmware_model.law.supervision.health import (
    Constants as HealthConstants,
    State as HealthState,
    clear_health,
)
from firmware_model.law.supervision.sensor_error import (
    State as SensorErrorState,
    clear_sensor_error,
    learn_sensor_error,
)
from firmware_model.law.supervision.signatures import (
    BIAS_ROW,
    DRIFT_ROW,
    FORCE_ECHO_ROW,
    FORCE_ROW,
    OFFSET_ROW,
    ROWS,
    TORQUE_ECHO_ROW,
    Constants as SignaturesConstants,
    State as SignaturesState,
    answers_no_more,
    begin,
    begin_all,
    begin_others,
    forget_sums,
    is_informed,
)
from firmware_model.law.supervision.witness import acquits, contradicts, unsure

if TYPE_CHECKING:
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
    health: Annotated[HealthConstants, "1", "of known faults that d̂ does not show"]
    both_lost: Annotated[
        float, "1", "lead in evidence for a loss of channel 2 after a loss of channel 1"
    ]


class State(Struct):
    """State."""

    signatures: Annotated[SignaturesState, "1", "of torque offset, lost force and sensor errors"]
    frozen: Annotated[FrozenState, "1", "of a frozen sensor"]
    health: Annotated[HealthState, "y²", "of known faults that d̂ does not show"]
    evidence: Annotated[
        FloatArray, "1", "of each hypothesis, by the number of its verdict", (HYPOTHESES,)
    ]
    verdict: Annotated[int, "1", "a Verdict"]
    found: Annotated[int, "1", "fault found in this tick; 0: none"]
    found_size: Annotated[float, "1", "size of a found actuator fault"]
    sensor_error: Annotated[SensorErrorState, "y", "known error of the sensor"]


@firmware
def take_evidence(
    table: Table, own: State, known: mismatch.State, heard: echoes.State, torque: float
) -> None:
    """Note the evidence of each hypothesis in this tick; ``torque`` is that of a lost torque."""
    own.evidence[TORQUE_LOST] = torque
    for i in range(table.hypotheses.signatures.n):
        row = table.hypotheses.signatures.rows[i]
        if is_informed(row, heard):
            own.evidence[row.fault] = own.signatures.rows[i].candidate.evidence
    own.evidence[SENSOR_FROZEN] = own.frozen.evidence
    own.evidence[ANOTHER_CAR] = other_car_evidence(table, known)


@firmware
def torque_evidence(known: mismatch.State, own: candidate.State, lost: bool, share: float) -> float:
    """The evidence of a lost torque: from the test, or where ``lost`` from the known share."""
    if lost:
        return real(0.5, share) * share * share / variance_of(known.covariance, SHARE)
    return own.evidence


@firmware
def other_car_evidence(table: Table, known: mismatch.State) -> float:
    """The evidence of the direction with the clearest difference between car and model."""
    half = real(0.5, known.variance)
    most = real(0.0, half)
    for i in range(LOSS_STATES, LOSS_STATES + table.other_cars.n):
        theta = known.theta[i]
        most = max(most, half * theta * theta / variance_of(known.covariance, i))
    return most


@firmware
def judge(
    table: Table,
    own: State,
    known: mismatch.State,
    heard: echoes.State,
    seen: witness.State,
    waits: bool,
    lost: bool,
    returned: float,
) -> None:
    """The verdict of this tick.

    Args:
        table: the constant table.
        own: with the evidence of this tick; changed in place.
        known: of the car; forgets what a found fault has taught.
        heard: what the actuators report; a reported fault is believed.
        seen: what the witness says.
        waits: whether a loss of the torque waits for its direct witness.
        lost: whether a loss of the torque is confirmed.
        returned: the evidence of its end.
    """
    evidence, confirm, was = own.evidence, table.decision.confirm, own.verdict
    own.found = NOTHING
    own.verdict = standing(table, own, heard, lost)
    if own.verdict == NOTHING:
        own.found_size = 0.0
    torque = strongest(evidence, TORQUE_LOST, FORCE_LOST)
    if lost:  # what is tested is its end
        torque = max(returned, evidence[TORQUE_OFFSET])
    excused = is_excused(table, own.signatures, seen)
    force, sensor = evidence[FORCE_LOST], of_sensor(table, evidence, seen, excused)
    apart, world = contradicts(table.witness, seen), of_world(evidence, waits, excused)
    actuators = max(torque, force)
    most = max(actuators, sensor)
    second = max(min(torque, force), min(actuators, sensor))
    if lost:
        ahead = force - max(torque, sensor) > table.hypotheses.both_lost
        if ahead and answers_no_more(own.signatures):
            own.verdict = BOTH_LOST
    elif is_reported(table, own, heard, FORCE_ECHO_ROW, most):
        find_by_echo(table, own, known, heard, FORCE_ECHO_ROW)
    elif is_reported(table, own, heard, TORQUE_ECHO_ROW, most) and not says_lost(
        table.echoes.actuators[TORQUE], heard.actuators[TORQUE]
    ):
        find_by_echo(table, own, known, heard, TORQUE_ECHO_ROW)
    elif world > confirm and world >= most and not apart:
        own.verdict = ANOTHER_CAR if own.verdict == NOTHING else own.verdict
    elif most > confirm and is_clear(table, own, most, second) and not apart:
        find(table, own, known, likeliest_fault(evidence, most))
    elif own.verdict == NOTHING and most > confirm:
        own.verdict = CANNOT_BE_TOLD
    elif own.verdict == NOTHING:
        enough = table.decision.suspect if was == ANOTHER_CAR else confirm
        own.verdict = ANOTHER_CAR if evidence[ANOTHER_CAR] > enough else NOTHING
    own.verdict = with_echoes(table, heard, lost, own.verdict)


@firmware
def of_sensor(table: Table, evidence: FloatArray, seen: witness.State, excused: bool) -> float:
    """The most evidence of a fault of the sensor that the witness does not deny."""
    most = strongest(evidence, SENSOR_WRONG, ANOTHER_CAR)
    if excused:
        most = evidence[SENSOR_FROZEN]
    if acquits(table.witness, seen):
        most = real(0.0, most)
    return most


@firmware
def is_excused(table: Table, own: signatures.State, seen: witness.State) -> bool:
    """Whether the witness denies a bias or drift of the sensor: neither wind nor road jumps."""
    since = seen.unbroken
    jumps = own.jump >= table.hypotheses.jump and since < own.rows[BIAS_ROW].candidate.age
    excused: bool = not jumps and sensor_waits(table, seen)
    return excused


@firmware
def of_world(evidence: FloatArray, waits: bool, excused: bool) -> float:
    """The most evidence of a fault that its direct witness denies: wind or road looks alike."""
    most = real(0.0, evidence[TORQUE_LOST])
    if waits:
        most = evidence[TORQUE_LOST]
    if excused:
        most = max(most, strongest(evidence, SENSOR_WRONG, SENSOR_FROZEN))
    return most


@firmware
def with_echoes(table: Table, heard: echoes.State, lost: bool, verdict: int) -> int:
    """The verdict of a tick, where a believed echo names the place."""
    torque, force = heard.actuators[TORQUE], heard.actuators[FORCE]
    if lost:
        gone = force.believed == 1 and says_lost(table.echoes.actuators[FORCE], force)
        verdict = BOTH_LOST if gone else verdict
    elif torque.believed == 1:
        verdict = (
            TORQUE_LOST if says_lost(table.echoes.actuators[TORQUE], torque) else TORQUE_OFFSET
        )
    elif force.believed == 1:
        verdict = FORCE_LOST
    return verdict


@firmware
def is_clear(table: Table, own: State, most: float, second: float) -> bool:
    """Whether the fault with the ``most`` evidence is distinguished from faults at other places.

    A bias begins with a jump; no torque can jump. Only d̂ since the onset of a lost channel 1
    distinguishes a lost channel 2 from a lost channel 1: where F̂ works on d̂, u2 answers to every
    d̂, and an earlier d̂ gives no present evidence.
    """
    constants = table.hypotheses
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
def is_reported(table: Table, own: State, heard: echoes.State, i: int, most: float) -> bool:
    """Whether the echo of row ``i`` explains d̂ at least half as well as any other fault.

    The echo would have to be wrong at the same time as another fault, and in the same way.
    """
    evidence, half = own.signatures.rows[i].candidate.evidence, real(0.5, most)
    explains = evidence > table.decision.confirm and evidence > half * most
    which = table.hypotheses.signatures.rows[i].echo
    reported: bool = explains and shows(table.echoes.actuators[which], heard.actuators[which])
    return reported


@firmware
def find_by_echo(
    table: Table, own: State, known: mismatch.State, heard: echoes.State, i: int
) -> None:
    """Record that the echo of row ``i`` tells the truth about its fault, or no longer does."""
    constants, row = table.hypotheses.signatures.rows[i], own.signatures.rows[i]
    echo = heard.actuators[constants.echo]
    if echo.believed == 0 and constants.echo == TORQUE:
        heard.between += heard.told_between
        heard.handed += heard.told_handed
    believe(table, known, echo, row.candidate, row.answer)
    begin(row)
    begin_all(own.signatures)
    own.found_size = 0.0
    own.found = constants.fault
    own.verdict = NOTHING


@firmware
def believe_with_witness(
    table: Table, own: State, known: mismatch.State, heard: echoes.State, seen: witness.State
) -> None:
    """Believe the echo of a lost torque without the sensor, once the witness shows the loss too."""
    echo, row = heard.actuators[TORQUE], own.signatures.rows[TORQUE_ECHO_ROW]
    actuator = table.echoes.actuators[TORQUE]
    missing = output(table.estimator.channel_1, row.answer, missing_command(actuator, echo))
    half = real(0.5, missing)
    explains = abs(seen.difference + missing) < half * abs(seen.difference)
    shown = seen.left > 0 and seen.witness_off > unsure(table.witness, seen)
    if shown and explains and echo.believed == 0 and says_lost(actuator, echo):
        find_by_echo(table, own, known, heard, TORQUE_ECHO_ROW)


@firmware
def standing(table: Table, own: State, heard: echoes.State, lost: bool) -> int:
    """The standing verdict of the last tick, without a new finding."""
    verdict: int = own.verdict
    if lost:
        if verdict != BOTH_LOST:
            verdict = CANNOT_BE_TOLD
            if own.evidence[TORQUE_LOST] > table.decision.confirm:
                verdict = TORQUE_LOST
        return verdict
    if verdict == SENSOR_FROZEN and own.frozen.repetitions > real(0.0, own.found_size):
        return verdict
    working = table.echoes.working
    if verdict == TORQUE_OFFSET and works(heard.actuators[TORQUE], working):
        verdict = NOTHING
    obeys = own.signatures.obeyed == 1 or works(heard.actuators[FORCE], working)
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
def find(table: Table, own: State, known: mismatch.State, fault: int) -> None:
    """Record a found ``fault``: the fault is present, or an earlier fault is gone.

    The weighed evidence is now known, so every candidate starts with a new onset.
    """
    weighed, sensor = own.signatures, own.sensor_error
    size = size_of(weighed, fault)
    if fault == SENSOR_WRONG:
        gone = learn_sensor_error(table, sensor, known, weighed.rows[BIAS_ROW], real(-1.0, size))
    elif fault == SENSOR_DRIFTING:
        drift = weighed.rows[DRIFT_ROW]
        gone = learn_sensor_error(table, sensor, known, drift, drift.ramp)
    else:
        opposite = own.found_size * size < real(0.0, size)
        gone = opposite and place_of(fault) == place_of(own.verdict)
    if fault == SENSOR_FROZEN:  # the jump to the repeated number was no bias
        sensor.offset = 0.0
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
    size = real(0.0, own.jump)
    if fault == TORQUE_OFFSET:
        size = own.rows[OFFSET_ROW].candidate.size_now
    elif fault == FORCE_LOST:
        size = own.rows[FORCE_ROW].candidate.size_now
    return size


@firmware
def clear_hypotheses(own: State) -> None:
    """Nothing is known."""
    for i in range(ROWS):
        begin(own.signatures.rows[i])
    forget_sums(own.signatures)
    thaw(own.frozen)
    clear_health(own.health)
    own.frozen.measurement = own.frozen.expected = own.found_size = 0.0
    own.evidence[:] = 0.0
    clear_sensor_error(own.sensor_error)
    own.verdict = own.found = NOTHING
