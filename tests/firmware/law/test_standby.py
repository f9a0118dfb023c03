"""Below its lowest design the controller stands by: entered and left without a bump."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.analysis.sampled_plant import follow_plant, sample
from firmware_model.firmware import Firmware
from firmware_model.law.status import FaultState, Mode
from tests.firmware.scheduled import SPEEDS, TARGET, TICK_S, car, scheduled

LOWEST = SPEEDS[0]
TICKS = 40  # of the way to zero
OF = scheduled(target=replace(TARGET, blind_s=0.04))
SLOW = 0.5 * LOWEST


def driven(firmware, speed, ticks, reference=0.0, measurement=0.0):
    """The answers of ``ticks`` ticks at one speed."""
    firmware.change_speed(speed)
    return [firmware.step(reference, measurement) for _ in range(ticks)]


@pytest.fixture
def firmware():
    made = Firmware(OF.table, speeds=OF.schedule)
    made.change_speed(LOWEST)
    made.reset(1.0)
    return made


@pytest.mark.compiled
def test_the_band_of_a_twentieth_below_the_lowest_design_keeps_the_mode(firmware):
    modes = []
    for share in (1.0, 0.951, 0.949, 0.97, 0.999, 1.0, 0.96, 2.0):
        modes.append(driven(firmware, share * LOWEST, TICKS + 1)[-1].mode)
    stands, runs = Mode.STANDBY, Mode.RUN
    assert modes == [runs, runs, stands, stands, stands, runs, runs, runs]


def test_both_commands_go_to_zero_in_a_straight_line_and_stay_there(firmware):
    before = driven(firmware, LOWEST, 50, reference=1.0, measurement=0.9)[-1]
    answers = driven(firmware, SLOW, TICKS + 10, reference=1.0, measurement=0.9)
    assert before.command_1 and before.command_2
    left = np.clip(1.0 - np.arange(1, TICKS + 11) / TICKS, 0.0, None)
    for name in ("command_1", "command_2"):
        commands = [getattr(answer, name) for answer in answers]
        np.testing.assert_allclose(commands, left * getattr(before, name), atol=1e-9)
    assert {answer.mode for answer in answers} == {Mode.STANDBY}
    assert {answer.fault_state for answer in answers} == {before.fault_state}


@pytest.mark.parametrize("missing", [(math.nan, 0.0), (0.0, math.nan)], ids=["r", "y"])
def test_standby_ends_after_the_way_to_zero_with_the_first_tick_that_has_both_inputs(
    firmware, missing
):
    assert driven(firmware, SLOW, 5)[-1].mode == Mode.STANDBY
    answers = driven(firmware, LOWEST, TICKS - 5)
    assert {answer.mode for answer in answers} == {Mode.STANDBY}
    assert driven(firmware, LOWEST, 3, *missing)[-1].mode == Mode.STANDBY
    assert driven(firmware, LOWEST, 1)[-1].mode == Mode.RUN


@pytest.mark.parametrize(("reference", "measurement"), [(0.0, 0.0), (1.0, 0.0), (0.4, -0.3)])
def test_the_first_commands_after_standby_are_those_before(firmware, reference, measurement):
    driven(firmware, SLOW, 3 * TICKS, reference, measurement)
    first, second = driven(firmware, LOWEST, 2, reference, measurement)
    assert (first.mode, second.mode) == (Mode.RUN, Mode.RUN)
    assert first.command_1 == pytest.approx(0.0, abs=1e-6)
    assert first.command_2 == pytest.approx(0.0, abs=1e-6)
    at_once = Firmware(OF.table, speeds=OF.schedule).step(reference, measurement)
    assert abs(second.command_1) <= 0.1 * abs(at_once.command_1)  # a step of the error


def test_a_car_that_turns_at_the_end_of_standby_shows_no_fault(firmware):
    """The car goes on like a released car: that is what F1 expects."""
    driven(firmware, SLOW, 3 * TICKS, 0.3, 0.3)
    first = driven(firmware, LOWEST, 1, 0.3, 0.3)[0]
    assert abs(first.fault_estimate) < 1e-9
    other = Firmware(OF.table, speeds=OF.schedule)
    assert abs(driven(other, LOWEST, 1, 0.3, 0.3)[0].fault_estimate) > 1e-3


class Car:
    """The model itself behind its bus, at the lowest speed."""

    def __init__(self, holding=0.0):
        plant = car(LOWEST)
        self._sampled = sample(plant, TICK_S)
        self._x = np.linalg.solve(plant.a, -plant.b[:, 0] * holding)
        self._sent = (0.0, 0.0)
        self.y = float(plant.c[0] @ self._x)

    def follow(self, answer, left=1.0):
        s, (torque, force) = self._sampled, self._sent
        self._sent = answer.command_1, answer.command_2
        self.y = float(follow_plant(s.phi, s.gamma, s.c, self._x, left * torque, force))


@pytest.mark.compiled
def test_a_car_that_was_turned_by_its_driver_shows_no_fault_while_it_comes_back(firmware):
    its = Car(holding=2.0)
    driven(firmware, SLOW, 3 * TICKS, 0.0, its.y)
    firmware.change_speed(LOWEST)
    largest, begin = 0.0, its.y
    for _ in range(300):
        answer = firmware.step(0.0, its.y)
        largest = max(largest, abs(answer.fault_estimate))
        its.follow(answer)
    assert abs(its.y) < 0.2 * abs(begin)
    assert largest < 1e-6 * abs(begin)


@pytest.mark.compiled
def test_a_known_loss_is_taken_over_after_a_short_standby_without_a_bump(firmware):
    its, forces = Car(), []
    firmware.reset(0.0)
    for tick in range(1500):
        answer = firmware.step(math.sin(0.01 * tick), its.y)
        its.follow(answer, left=float(tick < 200))
        forces.append(answer.command_2)
    assert answer.fault_state == FaultState.CONFIRMED
    firmware.change_speed(SLOW)
    for _ in range(TICKS):
        its.follow(firmware.step(1.0, its.y), left=0.0)
    firmware.change_speed(LOWEST)
    answer = firmware.step(1.0, its.y)
    assert (answer.mode, answer.fault_state) == (Mode.RUN, FaultState.CONFIRMED)
    assert abs(answer.command_2) < 0.02 * max(map(abs, forces))


@pytest.mark.compiled
def test_a_suspicion_ends_with_standby():
    """The suspected motion is over: a loss has to show again."""
    noisy = scheduled(target=replace(TARGET, blind_s=0.04, noise_rms=0.02))
    firmware, its = Firmware(noisy.table, speeds=noisy.schedule), Car()
    answer = driven(firmware, LOWEST, 1)[-1]
    for tick in range(2000):
        answer = firmware.step(0.3 * math.sin(0.01 * tick), its.y)
        if answer.fault_state == FaultState.SUSPECTED:
            break
        its.follow(answer, left=0.0)
    assert answer.fault_state == FaultState.SUSPECTED
    assert driven(firmware, SLOW, 3 * TICKS)[-1].fault_state == FaultState.SUSPECTED
    assert driven(firmware, LOWEST, 1)[0].fault_state in {FaultState.CLEAR, FaultState.CANNOT_TELL}
