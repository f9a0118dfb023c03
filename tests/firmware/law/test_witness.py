"""D* made of yaw rate and lateral acceleration: sensor, witness and model, two against one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from firmware_model.discretisation.targets import Witness
from firmware_model.firmware import Answer, Firmware
from firmware_model.law.status import FaultState, Mode, Verdict
from firmware_model.law.supervision.echoes import KEPT_TICKS
from tests.firmware.law.cases import TICK_S
from tests.firmware.law.test_echoes import (
    RMS,
    Car,
    dead,
    honest,
    lying,
    table_of as table_with_echoes,
    working,
)
from tests.firmware.scheduled import SPEEDS, TARGET as SCHEDULED, Blended, scheduled

WEIGHT, SPEED_MPS, PERIOD = 0.3, 12.0, 5
WITNESS = Witness(WEIGHT, SPEED_MPS, noise_rms=RMS)
FAULT, END = 150, 900

Error = Callable[[float, int], float]
"""From D* and the ticks since FAULT to what a sensor says."""


def table_of(witness: Witness | None = WITNESS, echoes: bool = False, **changes: Any) -> Any:
    return table_with_echoes(echoes=echoes, witness=witness, **changes)


def right(y: float, _k: int) -> float:
    return y


def missing(_y: float, _k: int) -> float:
    return math.nan


def off(y: float, _k: int) -> float:
    return y + 0.8


def swinging(y: float, k: int) -> float:
    return y + 0.5 * math.sin(0.05 * k)


def nothing(_y: float, _k: int) -> float:
    return 0.0


@dataclass
class Driven:
    """What came of a drive: answers and D* by tick."""

    answers: list[Answer]
    y: list[float]

    @property
    def states(self) -> list[int]:
        return [answer.fault_state for answer in self.answers]

    @property
    def verdicts(self) -> list[int]:
        return [answer.verdict for answer in self.answers]

    def off(self, other: Driven) -> float:
        """Largest distance of both D*."""
        both = zip(self.y, other.y, strict=False)  # one may end sooner
        return max(abs(one - another) for one, another in both)


def drive(
    table: Any,
    sensor: Error = right,
    hears: Error | None = right,
    acts: Any = working,
    echoes: Any = None,
    *,
    wanted: Callable[[int], float] = lambda k: math.sin(0.01 * k),
    until: int = END,
    push: float = 0.0,
    age: tuple[int, int] = (0, 0),
    slides: float = 0.0,
    end: int = END,
) -> Driven:
    """A drive in which sensor, witness and actuators err from FAULT on.

    ``hears``: what the witness says, every PERIOD ticks; None: no witness. ``until``: the sensor
    errs for so long. ``push``: a torque that nobody reports. ``age``: of the witness, and as told.
    ``slides``: a - V γ.
    """
    firmware, car, driven = Firmware(table), Car(), Driven([], [])
    noise = np.random.default_rng(7).normal(0.0, RMS, (3, END))
    for k in range(end):
        late, y = k - FAULT, car.y
        if hears is not None and k % PERIOD == 0:
            then = [*driven.y, y][max(k - age[0], 0)]
            said = hears(then, late) if late >= 0 else then
            turning, sliding = said - WEIGHT * slides, said + (1.0 - WEIGHT) * slides
            firmware.hear(3, (turning + noise[1, k]) / SPEED_MPS, age[1])
            firmware.hear(4, sliding + noise[2, k], age[1])
        if echoes is not None and k % PERIOD == 0:
            for channel, echo in enumerate(echoes(car.outputs, car.commands, k), 1):
                firmware.hear(channel, echo)
        measured = sensor(y, late) if 0 <= late < until - FAULT else y
        answer = firmware.step(wanted(k), measured + noise[0, k])
        torque, force = acts(*car.commands, late) if late >= 0 else car.commands
        car.go_on(torque + (push if late >= 0 else 0.0), force)
        car.commands = (answer.command_1, answer.command_2)
        driven.answers.append(answer)
        driven.y.append(car.y)
    return driven


@cache
def healthy() -> Driven:
    """The car without an error."""
    return drive(table_of(None), hears=None)


def commands(driven: Driven) -> list[tuple[float, float]]:
    return [(answer.command_1, answer.command_2) for answer in driven.answers]


@pytest.mark.compiled
@pytest.mark.parametrize("hears", [right, off, swinging, nothing, None])
def test_a_witness_of_a_healthy_car_changes_no_command_right_or_wrong(hears):
    assert commands(drive(table_of(), hears=hears)) == commands(healthy())


@pytest.mark.compiled
@pytest.mark.parametrize("sensor", [off, swinging, nothing, missing])
def test_the_witness_stands_in_for_a_wrong_sensor(sensor):
    heard, alone = drive(table_of(), sensor), drive(table_of(None), sensor, hears=None)
    assert FaultState.CONFIRMED not in heard.states
    assert heard.off(healthy()) < 0.4
    if sensor is not missing:
        assert heard.off(healthy()) < 0.3 * alone.off(healthy())
        denied = heard.verdicts.index(Verdict.SENSOR_WRONG)
        assert 0 <= denied - FAULT < 60
        assert set(heard.verdicts[denied + PERIOD :]) == {Verdict.SENSOR_WRONG}
        assert {answer.mode for answer in heard.answers[denied + PERIOD :]} == {Mode.BLIND}


@pytest.mark.compiled
def test_a_loss_is_confirmed_with_a_witness_as_soon_as_without():
    alone = drive(table_of(None), hears=None, acts=dead)
    heard = drive(table_of(), acts=dead)
    assert heard.states.index(FaultState.CONFIRMED) == alone.states.index(FaultState.CONFIRMED)
    assert heard.off(healthy()) <= alone.off(healthy())
    assert Verdict.TORQUE_LOST in heard.verdicts
    assert Verdict.SENSOR_WRONG not in heard.verdicts


@pytest.mark.compiled
def test_a_lost_torque_whose_echo_lies_is_confirmed_once_the_witness_shows_the_loss():
    honestly, against = (
        drive(table_of(echoes=True), acts=dead, echoes=says).states.index(FaultState.CONFIRMED)
        for says in (honest, lying)
    )
    assert FAULT < honestly < against < FAULT + 80


@pytest.mark.compiled
def test_a_loss_that_the_echo_denies_is_confirmed_once_no_gust_moves_the_car_so_far():
    found = [
        drive(table_of(echoes=True, gust=gust), acts=dead, echoes=lying).states.index(
            FaultState.CONFIRMED
        )
        for gust in (0.0, 0.1, 0.3)
    ]
    assert FAULT < found[0] < found[1] < found[2] < FAULT + 150


def dies_between_samples(y: float, k: int) -> float:
    return 0.0 if k > 0 else y


@pytest.mark.compiled
def test_a_sensor_that_jumps_is_no_car_in_the_wind():
    driven = drive(table_of(echoes=True, gust=0.35), dies_between_samples, echoes=honest, end=300)
    assert Verdict.ANOTHER_CAR not in driven.verdicts[FAULT : FAULT + PERIOD]
    assert Verdict.SENSOR_WRONG in driven.verdicts[FAULT : FAULT + PERIOD]
    assert FaultState.CONFIRMED not in driven.states


def dies_in_a_pushed_car(y: float, k: int) -> float:
    return 0.0 if k > 200 else y


@pytest.mark.compiled
def test_no_sample_from_before_a_fault_acquits_the_sensor():
    """Before the fault the witness confirms the sensor against a model that knows no push."""
    table, died = table_of(echoes=True, gust=0.35), FAULT + 201
    driven = drive(table, dies_in_a_pushed_car, echoes=lying, push=1.5)
    whole = drive(table, echoes=lying, push=1.5)
    assert driven.verdicts[died] == Verdict.SENSOR_WRONG
    assert FaultState.CONFIRMED not in driven.states[died:]
    assert driven.off(whole) < 0.2


def as_if_lost(y: float, k: int) -> float:
    """What a car without torque would do, at first."""
    return y - 8.0 * (TICK_S * k) ** 2


def carried_away(y: float, k: int) -> float:
    return y + 0.0004 * k


@pytest.mark.compiled
def test_a_drift_that_the_witness_sees_too_is_no_fault_of_the_sensor():
    assert Verdict.SENSOR_DRIFTING in drive(table_of(), carried_away, None).verdicts
    assert Verdict.SENSOR_DRIFTING not in drive(table_of(), carried_away, carried_away).verdicts


def test_with_all_witnesses_a_moved_car_is_another_car():
    table = table_of(echoes=True, gust=0.35)
    driven = drive(table, carried_away, carried_away, echoes=honest, end=450)
    assert set(driven.verdicts) == {Verdict.NOTHING, Verdict.ANOTHER_CAR}
    assert FaultState.CONFIRMED not in driven.states


def test_a_sensor_that_pretends_a_loss_deceives_only_until_the_witness_refutes():
    pretended = drive(table_of(), as_if_lost, until=FAULT + 300, end=600)
    begun = pretended.states.index(FaultState.CONFIRMED)
    ended = begun + pretended.states[begun:].index(FaultState.CLEAR)
    assert ended - begun < 60
    assert FaultState.CONFIRMED not in pretended.states[ended:]
    late = max(abs(answer.command_2) for answer in pretended.answers[-20:])
    assert late < 0.02 * max(abs(answer.command_2) for answer in pretended.answers)
    assert pretended.off(healthy()) < 0.4


@pytest.mark.parametrize("slides", [0.0, pytest.param(3.0, marks=pytest.mark.compiled)])
def test_the_echo_of_a_working_motor_keeps_a_pretended_loss_from_being_confirmed(slides):
    pretended = drive(table_of(echoes=True), as_if_lost, echoes=honest, slides=slides, end=450)
    assert FaultState.CONFIRMED not in pretended.states
    assert Verdict.SENSOR_WRONG in pretended.verdicts


@pytest.mark.compiled
def test_without_a_sensor_the_witness_shows_what_the_model_does_not_know():
    held = {"wanted": lambda k: 0.0, "push": 10.0}
    heard = drive(table_of(), missing, **held)
    blind = drive(table_of(None), missing, hears=None, **held)
    seen = drive(table_of(None), hears=None, **held)
    assert abs(heard.y[-1] - seen.y[-1]) < 0.1 * abs(blind.y[-1] - seen.y[-1])


@pytest.mark.compiled
@pytest.mark.parametrize(("hears", "last"), [(right, Mode.BLIND), (None, Mode.SAFE_STOP)])
def test_a_blind_controller_stops_unless_a_witness_comes(hears, last):
    driven = drive(table_of(blind_s=0.1), missing, hears)
    assert driven.answers[-1].mode == last


def falls_silent(y: float, k: int) -> float:
    return y if k < 100 else math.nan  # 100 ms later the witness counts for nothing


@pytest.mark.compiled
def test_a_denied_sensor_stays_denied_when_the_witness_falls_silent():
    driven = drive(table_of(blind_s=0.02), off, falls_silent)
    modes = [answer.mode for answer in driven.answers]
    stop = modes.index(Mode.SAFE_STOP)
    assert 200 < stop - FAULT < 225
    torques = [answer.command_1 for answer in driven.answers[stop - 1 : stop + 21]]
    steps = np.diff(torques)
    assert steps[:19] == pytest.approx(steps[0], rel=0.01)  # a straight line to zero
    assert torques[-1] == 0.0
    assert set(modes[stop:]) == {Mode.SAFE_STOP}


@pytest.mark.compiled
@pytest.mark.parametrize("moves", [True, False])
def test_a_sensor_that_works_again_is_believed_once_the_car_has_moved(moves):
    def wanted(k: int) -> float:
        return math.sin(0.01 * k) if moves or k < FAULT + 60 else 0.0

    table = table_of().copy()
    table.witness.working = 40
    driven = drive(table, off, wanted=wanted, until=FAULT + 60)
    assert Verdict.SENSOR_WRONG in driven.verdicts
    assert (driven.answers[-1].mode == Mode.RUN) is moves
    assert (driven.verdicts[-1] == Verdict.SENSOR_WRONG) is not moves


@pytest.mark.compiled
def test_an_unknown_speed_is_no_fault():
    def faster(y: float, k: int) -> float:
        return y * (1.0 + 0.2 * (1.0 - WEIGHT))

    strict = Witness(WEIGHT, SPEED_MPS, noise_rms=0.01 * RMS)
    table = table_of(strict)
    apart = Firmware(table)
    assert apart.hypotheses["verdict"] == Verdict.NOTHING
    doubtful = table_of(Witness(WEIGHT, SPEED_MPS, noise_rms=RMS, doubt=0.2))
    driven = drive(doubtful, hears=faster, sensor=right, acts=dead)
    sure = drive(table_of(), acts=dead)
    assert driven.states == sure.states


@pytest.mark.parametrize(
    "sample",
    [(3, math.nan, 0.0), (3, 1.0, math.nan), (3, 1.0, -1.0), (3, 1.0, KEPT_TICKS), (5, 1.0, 0.0)],
)
def test_what_is_no_sample_is_not_heard(sample):
    firmware, other = Firmware(table_of()), Firmware(table_of())
    for k in range(30):
        firmware.hear(4, 9.0)
        firmware.hear(*sample)
        assert firmware.step(0.1, 0.0) == other.step(0.1, 0.0), k


@pytest.mark.compiled
@pytest.mark.parametrize("age", [7, 30])
def test_a_sample_counts_for_the_tick_in_which_it_was_taken(age):
    """Old samples stand in for the sensor nearly as well as new ones, if their age is told."""
    honest_age, none_told = (drive(table_of(), missing, age=(age, told)) for told in (age, 0))
    assert honest_age.off(healthy()) < 0.5 * none_told.off(healthy())


def absurd(y: float, k: int) -> float:
    return 1e200 if k < 20 else y


def test_a_sensor_that_says_absurd_numbers_is_believed_again_after_all():
    table = table_of(limit_1=400.0, limit_2=4000.0).copy()
    table.witness.working = 40
    driven = drive(table, absurd, end=400)
    assert driven.answers[-1].mode == Mode.RUN
    assert driven.off(healthy()) < 0.5


def test_a_tick_that_overflows_forgets_the_samples():
    firmware, fresh = Firmware(table_of()), Firmware(table_of())
    for _ in range(20):
        firmware.hear(3, 0.3)
        firmware.hear(4, 3.0)
        firmware.step(0.1, 0.0)
    assert firmware.step(1e308, -1e308).mode == Mode.BLIND
    answers = [each.step(0.0, 0.0).verdict for each in (firmware, fresh)]
    assert answers[0] == answers[1]


def test_the_witness_knows_the_speed_of_a_car_that_says_it():
    """V beyond the designs counts too, where no other constant follows any more."""
    of = scheduled(target=replace(SCHEDULED, witness=WITNESS), cars=1)
    at = Blended(of)
    for speed_mps in (SPEEDS[0], 0.5 * (SPEEDS[0] + SPEEDS[-1]), 2.0 * SPEEDS[-1]):
        at.to(speed_mps)
        assert at.table.witness.speed == speed_mps


@pytest.mark.compiled
def test_an_unknown_torque_is_no_fault_of_a_sensor_that_the_witness_confirms():
    """D* alone takes the torque for a sensor's fault again and again."""
    sensor = {Verdict.SENSOR_WRONG, Verdict.SENSOR_DRIFTING, Verdict.SENSOR_FROZEN}
    heard = drive(table_of(), push=30.0)
    alone = drive(table_of(None), hears=None, push=30.0)
    assert not sensor & set(heard.verdicts[FAULT + 60 :])
    assert sensor & set(alone.verdicts[FAULT + 60 :])


def test_a_sample_older_than_the_memory_counts_for_nothing():
    late = Witness(WEIGHT, SPEED_MPS, lag_s=5 * TICK_S, noise_rms=RMS)
    oldest = KEPT_TICKS - 1
    driven = drive(table_of(late, blind_s=0.1), missing, age=(oldest, oldest), end=400)
    assert driven.answers[-1].mode == Mode.SAFE_STOP


def dies_later(torque: float, force: float, k: int) -> tuple[float, float]:
    return (torque, force) if k < 200 else (0.0, force)


@pytest.mark.compiled
@pytest.mark.parametrize("says", [None, lying])
def test_a_motor_that_dies_beside_a_denied_sensor_is_not_found(says):
    driven = drive(table_of(echoes=says is not None), nothing, acts=dies_later, echoes=says)
    assert driven.off(healthy()) > 0.5
    assert max(abs(answer.command_2) for answer in driven.answers) == 0.0


def test_a_motor_that_dies_beside_a_denied_sensor_is_compensated_from_its_echo():
    honestly = drive(table_of(echoes=True), nothing, acts=dies_later, echoes=honest, end=500)
    assert honestly.off(healthy()) < 0.3
    assert abs(honestly.y[-1] - healthy().y[499]) < 0.2


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_a_controller_begins_with_the_witness_alone(level):
    firmware, car = Firmware(table_of()), Car()
    firmware.begin()
    steady = np.linalg.solve(np.eye(len(car.a)) - car.a, car.b[:, 0])
    torque = level / float(car.c[0] @ steady)
    car.x, car.commands = steady * torque, (torque, 0.0)
    modes = []
    for k in range(400):
        if k % PERIOD == 0:
            firmware.hear(3, car.y / SPEED_MPS)
            firmware.hear(4, car.y)
        answer = firmware.step(1.0, math.nan)
        car.go_on(*car.commands)
        car.commands = (answer.command_1, answer.command_2)
        modes.append(answer.mode)
    assert Mode.RUN in modes[:PERIOD]
    assert car.y == pytest.approx(1.0, abs=0.01)


def test_without_a_sensor_of_the_output_both_do_what_their_sum_does():
    """Also where a sample, or the reference, is missing; nothing judges the sum."""
    makes, given = Firmware(table_of(replace(WITNESS, makes=True))), Firmware(table_of(None))
    random = np.random.default_rng(5)
    for k in range(600):
        r = math.nan if random.random() < 0.01 else math.sin(k / 40)
        turning, lateral = random.normal(0.8 * math.sin(k / 40) / np.array([SPEED_MPS, 1.0]), 0.02)
        lost = random.random() < 0.02
        if not lost:
            makes.hear(3, turning)
        makes.hear(4, lateral)
        y = WEIGHT * lateral + (1.0 - WEIGHT) * (SPEED_MPS * turning)
        commands = makes.step(r, math.nan)
        assert commands == given.step(r, math.nan if lost else y), k
    assert np.abs(commands).max() > 0.0
