"""What the controller does about a fault that is not the torque's: commands and bumps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.fault_decision.decision import acquit, begin_suspicion
from firmware_model.law.status import FaultState, Verdict
from tests.firmware.law.cases import DESIGN, NEVER, TICK_S, changed


def started(on_confirmation: bool = True, **changes: float) -> tuple[Any, Any]:
    target = Target(TICK_S, 1, "zoh", on_confirmation=on_confirmation, noise_rms=0.01, **changes)  # type: ignore[arg-type]
    table = changed(build(DESIGN, target), decision=NEVER)[0]
    return table, controller.init(table)[0]


def test_without_noise_a_number_that_is_repeated_tells_nothing() -> None:
    for noise_rms, told in ((0.01, True), (0.0, False)):
        table = build(DESIGN, Target(TICK_S, 1, "zoh", noise_rms=noise_rms))
        assert math.isfinite(table.hypotheses.frozen.least_motion) == told


@pytest.mark.compiled
@pytest.mark.parametrize("verdict", [Verdict.FORCE_LOST, Verdict.SENSOR_DRIFTING])
def test_no_verdict_takes_away_the_compensation_on_d_hat(verdict: Verdict) -> None:
    """The verdict may be wrong, and d̂ the loss that is compensated."""
    forces = []
    for found in (Verdict.NOTHING, verdict):
        table, state = started(on_confirmation=False)
        for k in range(200):
            controller.step(table, state, 0.0, -0.2)
            if k == 50 and found:
                state.hypotheses.verdict = state.hypotheses.found = found
                acquit(table, state)
            forces.append(float(state.command_2))
    np.testing.assert_array_equal(forces[:200], forces[200:])
    assert min(np.abs(forces[50:200])) > 100.0


@pytest.mark.compiled
def test_with_channel_2_lost_what_is_suspected_fades_without_a_bump() -> None:
    """F̂ gets what it had at first, and then less and less, whatever d̂ is."""
    table, state = started()
    state.fault_estimate = state.bumpless_transfer.carried = 0.2
    state.fault_state = FaultState.SUSPECTED
    state.hypotheses.verdict = state.hypotheses.found = Verdict.FORCE_LOST
    acquit(table, state)
    assert state.fault_state == FaultState.CLEAR
    carried = []
    for k in range(3000):
        controller.step(table, state, 0.0, -0.2 + 1e-3 * (k % 2))
        carried.append(float(state.bumpless_transfer.carried))
    changes = np.abs(np.diff([0.2, *carried]))
    assert changes.max() < 0.01 * 0.2
    assert abs(carried[-1]) < 1e-4
    assert abs(float(state.command_2)) < 1.0


def test_with_channel_2_lost_a_suspicion_is_not_compensated() -> None:
    for verdict, share in ((Verdict.NOTHING, 0.8), (Verdict.FORCE_LOST, 0.0)):
        table, state = started()
        table.sequential_test.share = 0.8
        state.hypotheses.verdict = verdict
        begin_suspicion(table, state)
        assert state.decision.suspected_share >= share
        assert (state.decision.suspected_share == 0.0) == (share == 0.0)
