"""The plant between ticks, against scipy's integration of the same equations."""

import math

import numpy as np
import pytest
from scipy import integrate

from firmware_model.analysis.sampled_plant import advance_plant, measure_plant, sample
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.errors import ParameterError


@pytest.mark.parametrize("plant", [steer_by_wire(), chapter_2()], ids=lambda p: p.name)
def test_is_exact_for_held_commands(plant):  # type: ignore[no-untyped-def]
    tick_s = 5e-3
    sampled = sample(plant, tick_s)
    commands = np.random.default_rng(7).standard_normal((40, 2)) * [30.0, 2000.0]
    x, expected = sampled.rest, np.zeros(len(plant.a))
    for u in commands:
        advance_plant(sampled.phi, sampled.gamma, x, sampled.rest, u[0], u[1])
        expected = integrate.solve_ivp(
            lambda _, state, u=u: plant.a @ state + plant.b @ u,
            (0.0, tick_s),
            expected,
            rtol=1e-11,
            atol=1e-13,
            method="DOP853",
        ).y[:, -1]
        np.testing.assert_allclose(x, expected, rtol=1e-8, atol=1e-10)
        assert measure_plant(sampled.c, x) == pytest.approx((plant.c @ expected).item(), rel=1e-7)


@pytest.mark.parametrize("tick_s", [0.0, -1.0, math.inf, math.nan])
def test_a_tick_that_is_no_tick_is_refused(tick_s):
    with pytest.raises(ParameterError, match="tick_s"):
        sample(steer_by_wire(), tick_s)
