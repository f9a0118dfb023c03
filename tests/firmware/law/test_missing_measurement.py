"""A missing measurement: the model's prediction stands in, and C is a feedforward."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.analysis.sampled_plant import follow_plant, sample
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import tustin, zoh
from firmware_model.law import controller
from firmware_model.law.status import FaultState, Mode, Verdict
from firmware_model.law.structs import FloatArray
from tests.firmware.law.cases import changed

TICK_S, LOST, MISSING, MISSED = 1e-3, 200, 600, 40
CAR = steer_by_wire()
PLANT = sample(CAR, TICK_S)
DESIGN = design(CAR, DesignSpecification(tau_s=0.002, tau_q_s=0.01))
SINE = np.sin(0.01 * np.arange(1200))


@dataclass(frozen=True)
class Run:
    """By tick, shape (ticks,): s w as d̂ of that tick contains it is ``lost``."""

    error: FloatArray
    estimate: FloatArray
    lost: FloatArray
    command_1: FloatArray
    command_2: FloatArray
    mode: FloatArray
    fault_state: FloatArray


def table_of(latency: int, **changes: object) -> Any:
    chosen = {"estimator": "zoh", "on_confirmation": True, **changes}
    return build(DESIGN, Target(TICK_S, latency, **chosen))  # type: ignore[arg-type]


def drive(table: Any, lost: int | None, missed: int = MISSED) -> Run:
    """A sine; no measurement in ``missed`` ticks from MISSING on, no channel 1 from ``lost`` on."""
    state, x, y = controller.init(table)[0], PLANT.rest, 0.0
    latency = int(table.estimator.latency_ticks)
    late = [(0.0, 0.0)] * latency
    rows = []
    for k, reference in enumerate(SINE.tolist()):
        missing = MISSING <= k < MISSING + missed
        loss = state.supervision.loss_model
        w = float(loss.share * loss.delay[state.estimator.queue_1.index])
        controller.step(table, state, reference, math.nan if missing else y)
        rows.append(
            (
                reference - y,
                state.fault_estimate,
                w,
                state.command_1,
                state.command_2,
                state.mode,
                state.fault_state,
            )
        )
        late.append((float(state.command_1), float(state.command_2)))
        u1, u2 = late.pop(0)
        left = 1.0 if lost is None or k < lost else 0.0
        y = follow_plant(PLANT.phi, PLANT.gamma, PLANT.c, x, left * u1, u2)
    run = Run(*np.array(rows, dtype=np.float64).T)
    blind = run.mode == Mode.BLIND
    assert np.flatnonzero(blind).tolist() == list(range(MISSING, MISSING + missed))
    return run


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 1, 3])
def test_a_car_that_is_the_model_is_driven_as_with_a_measurement(latency):
    """In a turn, where held commands would be wrong by the motion of the car."""
    run, seeing = drive(table_of(latency), None), drive(table_of(latency), None, 0)
    assert np.abs(np.diff(SINE[MISSING : MISSING + MISSED])).sum() > 0.1
    assert np.abs(run.estimate).max() < 1e-12
    np.testing.assert_allclose(run.error, seeing.error, atol=1e-9)
    assert not np.isin(run.fault_state, (FaultState.SUSPECTED, FaultState.CONFIRMED)).any()


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [1, 3])
def test_the_model_of_the_loss_goes_on(latency):
    """d̂ = s w after a loss of all (2.9), before, while and after measurements are missing."""
    run = drive(table_of(latency), LOST)
    known = np.arange(len(SINE)) > LOST + latency
    assert run.fault_state[-1] == FaultState.CONFIRMED
    assert np.abs(run.estimate[known]).max() > 0.5
    np.testing.assert_allclose(run.lost[known], run.estimate[known], atol=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [1, 3])
def test_the_compensation_goes_on(latency):
    """u2 = F̂ w of all commands since the loss, by scipy."""
    run = drive(table_of(latency), LOST)
    sent = np.where(np.arange(len(SINE)) < LOST - latency, 0.0, run.command_1)
    w = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, sent)
    expected = signal.sosfilt(tustin(DESIGN.compensator, TICK_S).sos, w)
    difference = np.abs(run.command_2 - expected) / np.abs(run.command_2).max()
    assert difference[MISSING - 100 :].max() < 1e-5
    seeing = drive(table_of(latency), LOST, 0)
    np.testing.assert_allclose(run.error, seeing.error, atol=1e-9)


def torques_of_another_car(gain: float, missing: range, blind_s: float) -> tuple[Any, Any]:
    """Commands 1 and modes at r = 1 of a car with ``gain`` times the model's D*."""
    table = table_of(1, blind_s=blind_s, on_confirmation=False)
    table = changed(table, compensator={"feedthrough": 0.0})[0]
    table.compensator.filter.n = 0
    state, x, y, told = controller.init(table)[0], PLANT.rest, 0.0, []
    late = [(0.0, 0.0)]
    for k in range(missing.stop + 600):
        controller.step(table, state, 1.0, math.nan if k in missing else gain * y)
        told.append((float(state.command_1), int(state.mode)))
        late.append((float(state.command_1), float(state.command_2)))
        y = follow_plant(PLANT.phi, PLANT.gamma, PLANT.c, x, *late.pop(0))
    torques, modes = np.array(told).T
    return torques, modes


@pytest.mark.compiled
def test_what_the_model_does_not_know_of_a_car_goes_on_too():
    """A settled car 20 % off keeps its torque: the prediction carries the difference."""
    torques, modes = torques_of_another_car(1.2, range(1500, 1900), 1.0)
    assert (modes[1500:1900] == Mode.BLIND).all()
    np.testing.assert_allclose(torques[1500:], torques[1499], rtol=0.01)


@pytest.mark.compiled
def test_a_measurement_that_comes_back_fades_in():
    """A car that changes unseen: C's answer to the difference is spread over some 50 ms."""
    table = changed(table_of(1, on_confirmation=False), compensator={"feedthrough": 0.0})[0]
    table.compensator.filter.n = 0
    state = controller.init(table)[0]
    controller.reset(table, state, 1.0)
    seen = [1.0] * 5 + [math.nan] * 100 + [0.9] * 400
    torques = []
    for y in seen:
        controller.step(table, state, 1.0, y)
        torques.append(float(state.command_1))
    # u1 = Q (r - y + G1 u1), with the difference from the prediction, 0.1, as 1 - e^(-t/50 ms)
    change = np.array(torques) - torques[0]
    modelled = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, np.concatenate([[0.0], change[:-1]]))
    shown = np.concatenate([np.zeros(105), 0.1 * (1.0 - np.exp(-np.arange(1, 401) / 50.0))])
    expected = signal.sosfilt(tustin(DESIGN.tracking.filter, TICK_S).sos, shown + modelled)
    np.testing.assert_allclose(change, expected, rtol=1e-6, atol=1e-6 * change.max())


@pytest.mark.compiled
def test_after_the_longest_time_the_commands_go_to_zero_in_the_same_time():
    """In a straight line, until a measurement ends the stop."""
    torques, modes = torques_of_another_car(1.0, range(1500, 1900), 0.1)
    assert (modes[1500:1600] == Mode.BLIND).all()
    assert (modes[1600:1900] == Mode.SAFE_STOP).all()
    assert (modes[1900:] == Mode.RUN).all()
    line = torques[1599] * np.linspace(1.0, 0.0, 101)[1:]
    np.testing.assert_allclose(torques[1600:1700], line, rtol=1e-9, atol=1e-9)
    assert (torques[1700:1900] == 0.0).all()
    np.testing.assert_allclose(torques[-1], torques[1499], rtol=0.02)


@pytest.mark.compiled
def test_a_frozen_sensor_is_a_missing_measurement():
    """The car follows its reference all the same; the frozen number is found by its repetition."""
    target = Target(TICK_S, 1, "zoh", noise_rms=0.005, resolution=1e-5, on_confirmation=True)
    table = build(DESIGN, target)
    noise = 0.005 * np.random.default_rng(3).standard_normal(len(SINE))
    state, x, y, rows = controller.init(table)[0], PLANT.rest, 0.0, []
    late = [(0.0, 0.0)]
    frozen = 0.0
    for k, reference in enumerate(SINE.tolist()):
        frozen = y + noise[k] if k < MISSING else frozen
        controller.step(table, state, reference, frozen)
        rows.append((reference - y, state.mode, state.supervision.hypotheses.verdict))
        late.append((float(state.command_1), float(state.command_2)))
        y = follow_plant(PLANT.phi, PLANT.gamma, PLANT.c, x, *late.pop(0))
    error, mode, verdict = np.array(rows, dtype=np.float64).T
    found = int(np.argmax(verdict == Verdict.SENSOR_FROZEN))
    assert MISSING < found < MISSING + 30
    assert (mode[found + 1 :] == Mode.BLIND).all()
    seeing = drive(table_of(1), None, 0)
    assert np.abs(error - seeing.error)[found + 300 :].max() < 0.02
