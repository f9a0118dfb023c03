"""What is learnt of the car: against a Kalman filter in full matrices."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_model.law.structs import Precision, zeroed
from firmware_model.law.supervision import mismatch
from firmware_model.law.supervision.covariance import LOSS_STATES, MAX_DIRECTIONS, MAX_STATES
from firmware_model.law.supervision.mismatch import clear_mismatch, innovation, learn_loss
from tests.firmware.law.cases import covariance_of

COLOUR = 0.6


def begun(precision: Precision = "float64", **changes: Any) -> tuple[Any, Any]:
    """Constants and state of a filter with four other cars and some numbers of its own."""
    constants = zeroed(mismatch.Constants, precision)[0]
    state = zeroed(mismatch.State, precision)[0]
    chosen = {
        "n": MAX_STATES, "prior": 0.36, "forgetting": [0.0, 0.0, 0.01, 0.02, 0.03, 0.05, 0.1],
        "growth": [0.0, 0.0, 0.01, 0.003, 0.002, 0.004, 0.2], "white": 0.1, "noise": 1e-4,
        **changes,
    }  # fmt: skip
    for name, value in chosen.items():
        constants[name] = value
    constants.whitener.n = 1
    constants.whitener.coefficients[0] = 1.0, 1.0 - COLOUR, 0.0, 1.0, 0.0  # 1 - COLOUR/z
    clear_mismatch(constants, state)
    return constants, state


class FullMatrices:
    """The same filter, in Joseph's form: P stays symmetric and positive."""

    def __init__(self, constants: Any) -> None:
        self.constants, self.theta = constants, np.zeros(MAX_STATES)
        self.p = np.diag([0.0] * LOSS_STATES + [float(constants.prior)] * MAX_DIRECTIONS + [0.0])

    def learn_loss(self, share: float, moment: float) -> None:
        self.theta[:2] = self.p[:2, :] = self.p[:, :2] = 0.0
        self.p[0, 0], self.p[1, 1] = share, moment

    def step(self, x: NDArray[Any], value: float, wander: float, remainder: float) -> Any:
        """Innovation and its variance."""
        c = self.constants
        r = c.noise + c.white * remainder
        s = x @ self.p @ x + r
        new = value - x @ self.theta
        gain = self.p @ x / s
        memory = np.diag(1.0 - wander * c.forgetting)
        grows = np.diag(c.growth * np.array([0.0, 0.0] + [wander] * MAX_DIRECTIONS + [remainder]))
        left = np.eye(MAX_STATES) - np.outer(gain, x)
        self.theta = memory @ (self.theta + gain * new)
        p = left @ self.p @ left.T + r * np.outer(gain, gain)
        self.p = memory @ p @ memory + grows
        return new, s


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_kalman_filter_of_full_matrices(seed):
    draw = np.random.default_rng(seed)
    constants, state = begun()
    theirs, before = FullMatrices(constants), 0.0
    for k, residual in enumerate(draw.standard_normal(60)):
        if k in (20, 45):  # a first and a second confirmed loss
            learn_loss(constants, state, 0.09, 25.0)
            theirs.learn_loss(0.09, 25.0)
        state.regressor[:] = x = draw.standard_normal(MAX_STATES)
        state.extent, state.change, state.remainder = draw.uniform(0.0, 2.0, 3)
        wander = min(state.change / state.extent, 1.0)
        expected = theirs.step(x, residual - COLOUR * before, wander, float(state.remainder))
        before = residual
        ours = innovation(constants, state, residual, 0.0, 0.0, 0.0)
        assert (ours, state.variance) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(state.theta, theirs.theta, atol=1e-9)
        np.testing.assert_allclose(covariance_of(state), theirs.p, atol=1e-9)


def test_so_is_a_residual_that_is_no_number_though_x_is_one():
    constants, state = begun()
    state.regressor[:] = state.extent = 0.1
    innovation(constants, state, math.inf, 0.0, 0.0, 0.0)
    assert np.isfinite(state.variance)
    assert not state.theta.any()
    assert state.previous_residual == 0.0


def test_a_car_that_has_never_moved_may_be_any():
    """Nothing has shown yet, so there is no ratio of change to extent."""
    constants, state = begun()
    state.extent = state.change = 0.0
    innovation(constants, state, 0.1, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(state.memory[2:], 1.0 - constants.forgetting[2:])


@pytest.mark.parametrize("huge", [1e200, math.inf, math.nan])
def test_an_overflow_is_forgotten(huge):
    constants, state = begun()
    constants.prior = 0.49
    _, fresh = begun(prior=0.49)
    learn_loss(constants, state, 0.09, 25.0)
    state.x[:] = state.previous_model_output = 3.0
    for value in (0.1, huge, -huge):
        state.regressor[:] = value
        state.extent, state.change, state.remainder = value, value, 0.0
        innovation(constants, state, value, 0.0, 0.0, 0.0)
    for name in (
        "x", "theta", "extent", "change", "remainder", "previous_model_output", "previous_residual",
    ):  # fmt: skip
        np.testing.assert_array_equal(state[name], fresh[name], err_msg=name)
    assert state.covariance.variances.tolist() == fresh.covariance.variances.tolist()
    assert not state.covariance.lower.any()


def test_the_states_of_a_loss_take_no_part_before_any_loss():
    """The same numbers as with a loss of which nothing is seen."""
    draw = np.random.default_rng(7)
    constants, without = begun()
    _, known = begun()
    learn_loss(constants, without, 0.0, 0.0)
    for k, residual in enumerate(draw.standard_normal(60)):
        if k == 30:  # what has been learnt of a loss stays with the others once it is withdrawn
            learn_loss(constants, known, 0.09, 25.0)
        if k == 40:
            learn_loss(constants, known, 0.0, 0.0)
        x = draw.standard_normal(MAX_STATES)
        x[:LOSS_STATES] = 0.0
        change = draw.uniform(0.0, 2.0, 3)
        for state in (without, known):
            state.regressor[LOSS_STATES:] = x[LOSS_STATES:]
            state.extent, state.change, state.remainder = change
        ours = innovation(constants, without, residual, 0.0, 0.0, 0.0)
        assert ours == pytest.approx(innovation(constants, known, residual, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(without.theta, known.theta, atol=1e-12)
    np.testing.assert_allclose(covariance_of(without), covariance_of(known), atol=1e-12)
