"""Missing inputs: the commands are held, and whatever models the plant goes on with them."""

from __future__ import annotations

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
from firmware_model.law.status import FaultState, Mode
from firmware_model.law.structs import FloatArray

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
        loss = state.loss_model
        w = float(loss.share * loss.delay[state.estimator.delay_index])
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
    held = run.mode == Mode.HOLD
    assert np.flatnonzero(held).tolist() == list(range(MISSING, MISSING + missed))
    return run


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 1, 3])
def test_f1_goes_on_with_the_commands_that_are_held(latency: int) -> None:
    """In a turn, where a model that stood still would be wrong by what the car has moved on."""
    run = drive(table_of(latency), None)
    assert np.abs(np.diff(SINE[MISSING : MISSING + MISSED])).sum() > 0.1
    assert np.abs(run.estimate).max() < 1e-12
    assert not np.isin(run.fault_state, (FaultState.SUSPECTED, FaultState.CONFIRMED)).any()


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [1, 3])
def test_so_does_the_model_of_the_loss(latency: int) -> None:
    """d̂ = s w after a loss of all (2.9), before, while and after inputs are missing."""
    run = drive(table_of(latency), LOST)
    known = (np.arange(len(SINE)) > LOST + latency) & (run.mode == Mode.RUN)
    assert run.fault_state[-1] == FaultState.CONFIRMED
    assert np.abs(run.estimate[known]).max() > 0.5
    np.testing.assert_allclose(run.lost[known], run.estimate[known], atol=1e-12)


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [1, 3])
def test_the_compensation_goes_on(latency: int) -> None:
    """u2 = F̂ w of all commands since the loss, by scipy: of those that were held too.

    What X_diff could not do, as it was held itself, is made up for in a tick.
    """
    run = drive(table_of(latency), LOST)
    sent = np.where(np.arange(len(SINE)) < LOST - latency, 0.0, run.command_1)
    w = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, sent)
    expected = signal.sosfilt(tustin(DESIGN.compensator, TICK_S).sos, w)
    load = np.abs(run.command_2).max()
    first = MISSING + MISSED
    difference = np.abs(run.command_2 - expected) / load
    assert difference[MISSING - 100 : MISSING].max() < 1e-5
    missing = signal.sosfilt(zoh(CAR.g2, TICK_S).sos, expected - run.command_2)
    assert missing[first] > 0.05
    assert np.abs(missing[first + 1 :]).max() < 0.06 * missing[first]
    healthy = drive(table_of(latency), None)
    later = slice(first + 300, None)
    np.testing.assert_allclose(run.error[later], healthy.error[later], atol=0.01)
