"""Saved knowledge: a restarted controller goes on with the loss, the sensor and the car."""

from typing import Any

import numpy as np
import pytest

from firmware_model.firmware import Firmware
from firmware_model.law import controller
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.supervision import knowledge
from tests.firmware.law.cases import Loop, restarted_table

PLANT = Loop.plant


def table_of(**changes: Any) -> Any:
    return restarted_table(**{"noise_rms": 0.002, **changes})


TABLE = table_of()


def restart(loop: Loop, remembers: bool) -> None:
    saved = loop.firmware.saved()
    loop.firmware = Firmware(TABLE)
    loop.firmware.begin()
    assert loop.firmware.restore(saved if remembers else b"") is remembers


def lost(working: float = 0.0, at: int = 600, end: int = 3000, **changes: Any) -> Loop:
    """A loop with a confirmed loss since the tick ``at``, at the tick ``end``."""
    loop = Loop(table_of(**changes) if changes else TABLE, noise_rms=0.002)
    loop.run(at)
    loop.working = working
    answers = loop.run(end - at)
    assert answers[-1].fault_state == FaultState.CONFIRMED
    return loop


@pytest.mark.compiled
@pytest.mark.parametrize("working", [0.0, 0.5])
def test_a_known_loss_is_compensated_from_the_first_tick(working):
    largest = {}
    for remembers in (True, False):
        loop = lost(working)
        restart(loop, remembers)
        states, errors = [], []
        for _ in range(2000):
            states.append(loop.run(1)[0].fault_state)
            errors.append(abs(loop.output - loop.reference))
        assert (states[0] == FaultState.CONFIRMED) is remembers
        largest[remembers] = max(errors)
        if remembers:
            assert set(states) == {FaultState.CONFIRMED}
    assert largest[True] < 0.7 * largest[False]


@pytest.mark.compiled
@pytest.mark.parametrize("on_confirmation", [True, False])
def test_the_steady_state_with_a_known_loss_repeats_its_commands(on_confirmation):
    """At y = r every tick answers the same; d̂ is the lost part of y."""
    quiet = table_of(noise_rms=0.0, on_confirmation=on_confirmation)
    loop = lost(0.5, on_confirmation=on_confirmation)
    state = controller.init(quiet)[0]
    state.supervision.saved = knowledge.saved_in(loop.firmware._states[0])
    state.supervision.saved.theta[:] = 0.0  # the model itself
    share = float(state.supervision.saved.share)
    assert share == pytest.approx(0.5, abs=0.02)
    controller.settle_loop(quiet, state, state.supervision, 0.8)
    first = [float(state[name]) for name in ("command_1", "command_2", "fault_estimate")]
    assert first[2] == pytest.approx(share * 0.8, rel=1e-9)
    for _ in range(50):
        controller.step(quiet, state, 0.8, 0.8)
        now = [float(state[name]) for name in ("command_1", "command_2", "fault_estimate")]
        assert now == pytest.approx(first, rel=1e-6)
    gain_1, gain_2 = (PLANT.c @ np.linalg.solve(np.eye(len(PLANT.c)) - PLANT.phi, PLANT.gamma)).T
    assert (1.0 - share) * gain_1 * first[0] + gain_2 * first[1] == pytest.approx(0.8, rel=1e-3)


@pytest.mark.compiled
def test_a_known_error_of_the_sensor_stays_known():
    loop = Loop(TABLE, noise_rms=0.002)
    loop.run(500)
    loop.bias = 0.2
    assert loop.run(1500)[-1].verdict == Verdict.SENSOR_WRONG
    restart(loop, True)
    answers = loop.run(3000)
    assert {answer.verdict for answer in answers} == {Verdict.SENSOR_WRONG}
    assert FaultState.CONFIRMED not in {answer.fault_state for answer in answers}
    loop.bias = 0.0
    assert Verdict.NOTHING in {answer.verdict for answer in loop.run(2000)}


@pytest.mark.compiled
def test_the_car_stays_known():
    loop = Loop(TABLE, noise_rms=0.002)
    loop.run(1000)
    known = loop.firmware._states[0].supervision.mismatch
    theta = known.theta.copy()
    restart(loop, True)
    state = loop.firmware._states[0]
    loop.firmware.step(np.nan, np.nan)
    controller.take_over(TABLE, state, state.supervision, 0.0, 0.0)
    np.testing.assert_array_equal(state.supervision.mismatch.theta[2:], theta[2:])
    assert theta[2:].any()


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_one_flipped_bit_anywhere_is_refused(precision):
    table = table_of(precision=precision)
    firmware = Firmware(table)
    firmware.reset(0.5)
    whole = firmware.saved()
    assert firmware.saved() == whole
    other = Firmware(table)
    assert other.restore(whole)
    for bit in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        assert not other.restore(bytes(damaged)), bit
    assert not other.restore(whole[:-1])
    assert not Firmware(table_of(precision=precision, noise_rms=0.003)).restore(whole)
    assert other.saved() == whole


def test_saved_knowledge_ends_with_a_reset_and_outlives_ticks_without_inputs():
    loop = lost(at=200, end=400)
    whole = loop.firmware.saved()
    firmware = Firmware(TABLE)
    firmware.begin()
    assert firmware.restore(whole)
    for _ in range(20):
        firmware.step(np.nan, np.nan)
    assert firmware.saved() == whole
    again = Firmware(TABLE)
    again.begin()
    assert again.restore(whole)
    answer = again.step(loop.reference, loop.reference)
    assert answer.fault_state == FaultState.CONFIRMED
    firmware.reset(0.0)
    assert firmware.step(0.0, 0.0).fault_state != FaultState.CONFIRMED


def test_a_frozen_sensor_before_a_restart_says_nothing_of_the_sensor_after():
    loop = Loop(TABLE, noise_rms=0.002)
    frozen = loop.run(200)[-1]
    firmware = loop.firmware
    for _ in range(80):
        frozen = firmware.step(loop.reference, 0.5)
    assert frozen.verdict == Verdict.SENSOR_FROZEN
    saved = firmware.saved()
    other = Firmware(TABLE)
    other.begin()
    assert other.restore(saved)
    assert other.step(0.0, 0.0).verdict != Verdict.SENSOR_FROZEN
