"""What the controller does about a fault that is not the torque's: commands and bumps."""

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.status import Verdict
from tests.firmware.law.cases import DESIGN, NEVER, TICK_S, changed


def started(on_confirmation: bool = True, **changes: float) -> tuple[Any, Any]:
    target = Target(TICK_S, 1, "zoh", on_confirmation=on_confirmation, noise_rms=0.01, **changes)  # type: ignore[arg-type]
    table = changed(build(DESIGN, target), decision=NEVER)[0]
    return table, controller.init(table)[0]


def test_without_noise_a_number_that_is_repeated_tells_nothing():
    for noise_rms, told in ((0.01, True), (0.0, False)):
        table = build(DESIGN, Target(TICK_S, 1, "zoh", noise_rms=noise_rms))
        assert math.isfinite(table.hypotheses.frozen.least_motion) == told


@pytest.mark.compiled
@pytest.mark.parametrize("verdict", [Verdict.FORCE_LOST, Verdict.SENSOR_DRIFTING])
def test_no_verdict_takes_away_the_compensation_on_d_hat(verdict):
    """The verdict may be wrong, and d̂ the loss that is compensated."""
    forces = []
    for found in (Verdict.NOTHING, verdict):
        table, state = started(on_confirmation=False)
        for k in range(200):
            controller.step(table, state, 0.0, -0.2)
            if k == 50 and found:
                state.hypotheses.verdict = state.hypotheses.found = found
            forces.append(float(state.command_2))
    np.testing.assert_array_equal(forces[:200], forces[200:])
    assert min(np.abs(forces[50:200])) > 100.0
