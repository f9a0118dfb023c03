"""A controller as one object: its commands, and the commands that came too late."""

from typing import Any

import numpy as np
import pytest

from firmware_model.analysis.sampled_plant import sample
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Firmware
from firmware_model.law.core.biquad import advance, at_rest
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.supervision.signatures import BIAS_ROW

TICK_S = 0.001
PLANT = sample(steer_by_wire(), TICK_S)


def table(latency_ticks, precision="float64", **known):
    specification = DesignSpecification(tau_s=0.01, tau_q_s=0.02)
    target = Target(
        tick_s=TICK_S, latency_ticks=latency_ticks, estimator="zoh", precision=precision, **known
    )
    return build(design(steer_by_wire(), specification), target)


def run(firmware, latency, lost, tell):
    """|d̂| by tick of a loop whose commands of the ticks ``lost`` never reach the actuators."""
    state, acting = PLANT.rest, np.zeros(2)
    on_the_way = [np.zeros(2)] * latency
    estimates = []
    for tick in range(200):
        due = on_the_way.pop(0)
        if due is None:
            due = acting
            if tell:
                firmware.act(*acting)
        acting = due
        answer = firmware.step(1.0, float(PLANT.c @ state))
        estimates.append(abs(answer.fault_estimate))
        command = np.array([answer.command_1, answer.command_2])
        on_the_way.append(None if tick in lost else command)
        state = PLANT.phi @ state + PLANT.gamma @ acting
    return np.array(estimates)


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [1, 2, 3])
@pytest.mark.parametrize("lost", [{5}, {0, 7, 8, 9, 60}], ids=str)
def test_commands_that_were_late_are_no_fault_to_who_knows(latency, lost):
    told, untold = (run(Firmware(table(latency)), latency, lost, tell) for tell in (True, False))
    assert told.max() < 1e-12
    assert untold.max() > 1e-5


def test_the_commands_are_those_of_the_last_answer_and_of_a_reset():
    firmware = Firmware(table(1))
    answer = firmware.step(1.0, 0.0)
    assert firmware.commands == (answer.command_1, answer.command_2) != (0.0, 0.0)
    firmware.reset(0.0)
    assert firmware.commands == (0.0, 0.0)


@pytest.mark.parametrize("known", [FaultState.CONFIRMED, FaultState.CLEAR])
@pytest.mark.parametrize("latency", [1, 3])
def test_a_lost_channel_owes_what_it_was_told_in_time(latency, known):
    """Commands on their way, of which the first turns out to be too late."""
    firmware, constants = Firmware(table(latency)), table(latency).estimator
    state, sent = firmware._states[0], [30.0, -40.0, 55.0][:latency]
    state.fault_state = known
    owing: list[Any] = [state.supervision.sequential_test, state.supervision.loss_model]
    for k, command in enumerate(sent):
        state.estimator.queue_1.commands[k] = command
        for each in owing:
            each.delay[k] = advance(constants.channel_1, each.channel_1, command)
    firmware.act(7.0, 0.0)
    for each, told in zip(owing, (True, known == FaultState.CONFIRMED), strict=True):
        expected = at_rest()
        acted = [7.0, *sent[1:]] if told else sent
        shown = [advance(constants.channel_1, expected, command) for command in acted]
        assert each.delay[:latency] == pytest.approx(shown, abs=1e-12)
        np.testing.assert_allclose(
            each.channel_1.accumulators, expected.accumulators, rtol=0, atol=1e-12
        )


def test_nothing_is_known_of_a_fault_at_rest():
    firmware = Firmware(table(1))
    assert firmware.hypotheses.verdict == Verdict.NOTHING
    firmware.step(1.0, 0.0)
    assert firmware.hypotheses.signatures.rows[BIAS_ROW].candidate.age == 1.0


@pytest.mark.compiled
def test_a_plant_driven_by_the_commands_themselves_changes_no_bit():
    table = build(design(steer_by_wire(), DesignSpecification()), Target(0.001, latency_ticks=1))
    ours, driven = Firmware(table), Firmware(table)
    for k in range(60):
        measurement = 0.01 * k
        answer = ours.step(1.0, measurement)
        assert driven.step(1.0, measurement) == answer
        driven.drive_with(answer.command_1, answer.command_2)


def test_measured_inputs_drive_the_estimate():
    """A motor that applies nothing, as a measurement shows, leaves no mismatch to D* at rest."""
    table = build(design(steer_by_wire(), DesignSpecification()), Target(0.001, latency_ticks=1))
    told, untold = Firmware(table), Firmware(table)
    for _ in range(50):
        measured, assumed = told.step(0.1, 0.0), untold.step(0.1, 0.0)
        told.drive_with(0.0, 0.0)
    assert abs(measured.fault_estimate) < 1e-9 < abs(assumed.fault_estimate)
