"""The loop at every speed of a schedule, and while the speed changes."""

import numpy as np
import pytest

from firmware_model.analysis.margins import law_in
from firmware_model.analysis.sampled_loop import sampled_loop
from firmware_model.analysis.speed_sweep import BETWEEN, sweep, table_at
from firmware_model.design.actuator_dynamics import IDEAL, Stage
from tests.firmware.scheduled import SPEEDS, TICK_S, car, scheduled

OF = scheduled(SPEEDS[:2])
LOST = (0.0, 1.0)


@pytest.mark.parametrize("left", [(1.0, 1.0), pytest.param(LOST, marks=pytest.mark.compiled)])
def test_a_loop_that_is_stable_everywhere(left):
    found = sweep(OF, car, TICK_S, 8.0, left)
    assert found.stable
    assert found.speeds == BETWEEN + 1
    alone = [
        sampled_loop(law_in(scheduled((speed,)).table, left), car(speed), TICK_S, left)
        for speed in SPEEDS[:2]
    ]
    assert found.spectral_radius >= max(loop.spectral_radius() for loop in alone) - 1e-9
    assert SPEEDS[0] <= found.at_mps <= SPEEDS[1]


@pytest.mark.compiled
def test_slowly_it_shrinks_as_the_frozen_loops_do():
    """Long at each speed, the cycle has the mean of the frozen rates."""
    found = sweep(OF, car, TICK_S, 0.05)
    slowest = [
        sampled_loop(law_in(table_at(OF, speed), (1.0, 1.0)), car(speed), TICK_S).spectral_radius()
        for speed in np.linspace(SPEEDS[0], SPEEDS[1], BETWEEN + 1).tolist()
    ]
    assert min(slowest) - 1e-6 <= found.while_changing <= max(slowest) + 1e-6
    assert found.between_mps == SPEEDS[:2]


@pytest.mark.compiled
def test_a_car_that_the_designs_do_not_know_is_not_stable():
    slow = (Stage(0.4), Stage(0.4), IDEAL)
    found = sweep(OF, lambda speed: car(speed, slow, mass=0.3), TICK_S, 8.0, LOST)
    assert not found.stable
    assert found.spectral_radius > 1.0 and found.while_changing > 1.0
