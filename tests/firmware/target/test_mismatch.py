"""What is learnt of the car: against a Kalman filter in full matrices and scipy's filters."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.target import controller
from firmware_model.target.fault_decision import mismatch
from firmware_model.target.fault_decision.covariance import MAX_STATES
from firmware_model.target.fault_decision.mismatch import (
    advance_cars,
    clear_mismatch,
    innovation,
    predict_mismatch,
    settle_mismatch,
)
from firmware_model.target.structs import Precision, Record, record_type
from tests.firmware.target.cases import CAR, TICK_S, other_cars

DESIGN = design(CAR, DesignSpecification(tau_s=0.005, tau_q_s=0.02))
COLOUR, NOISE_RMS = 0.6, 0.01


def begun(precision: Precision = "float64", **changes: Any) -> tuple[Record, Record]:
    """Constants and state of a filter with one other car and some numbers of its own."""
    constants = np.zeros(1, record_type(mismatch.CONSTANTS, precision))[0]
    state = np.zeros(1, record_type(mismatch.STATE, precision))[0]
    chosen = {
        "cars": 3, "n": MAX_STATES, "prior": 0.36, "forgetting": [0.01, 0.02, 0.03, 0.1],
        "growth": [0.01, 0.003, 0.002, 0.2], "white": 0.1, "noise": 1e-4, "colour": COLOUR,
        **changes,
    }  # fmt: skip
    for name, value in chosen.items():
        constants[name] = value
    clear_mismatch(constants, state)
    return constants, state


class FullMatrices:
    """The same filter, in Joseph's form: P stays symmetric and positive."""

    def __init__(self, constants: Record) -> None:
        self.constants, self.theta = constants, np.zeros(MAX_STATES)
        cars = int(constants.cars)
        self.p = np.diag([float(constants.prior)] * cars + [0.0] * (MAX_STATES - cars))

    def step(self, x: NDArray[Any], value: float, wander: float, remainder: float) -> Any:
        """Innovation and its variance."""
        c = self.constants
        r = c.noise + c.white * remainder
        s = x @ self.p @ x + r
        new = value - x @ self.theta
        gain = self.p @ x / s
        memory = np.diag(1.0 - wander * c.forgetting)
        grows = np.diag(c.growth * np.array([wander] * (MAX_STATES - 1) + [remainder]))
        left = np.eye(MAX_STATES) - np.outer(gain, x)
        self.theta = memory @ (self.theta + gain * new)
        p = left @ self.p @ left.T + r * np.outer(gain, gain)
        self.p = memory @ p @ memory + grows
        return new, s


@given(seed=st.integers(0, 2**32 - 1))
def test_it_is_the_kalman_filter_of_full_matrices(seed: int) -> None:
    draw = np.random.default_rng(seed)
    constants, state = begun()
    theirs, before = FullMatrices(constants), 0.0
    for residual in draw.standard_normal(60):
        state.regressor[:] = x = draw.standard_normal(MAX_STATES)
        state.extent, state.change, state.remainder = draw.uniform(0.0, 2.0, 3)
        wander = min(state.change / state.extent, 1.0)
        expected = theirs.step(x, residual - COLOUR * before, wander, float(state.remainder))
        before = residual
        ours = innovation(constants, state, residual)
        assert (ours, state.variance) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(state.theta, theirs.theta, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float64", "float32"])
@given(seed=st.integers(0, 2**32 - 1), noise=st.sampled_from([1e-18, 1e-8, 1e-2]),
       moves=st.sampled_from([0.0, 1e-4, 1.0]))  # fmt: skip
def test_the_variance_of_an_innovation_is_never_below_that_of_the_noise(
    seed: int, noise: float, moves: float, precision: Precision
) -> None:
    """A car that hardly moves shows the same x for ever, of which more and more is known."""
    draw = np.random.default_rng(seed)
    constants, state = begun(precision, noise=noise)
    still = 10.0 * draw.standard_normal(MAX_STATES)
    for _ in range(200):
        state.regressor[:] = still * (1.0 + moves * draw.standard_normal(MAX_STATES))
        state.extent, state.change, state.remainder = 1.0, moves, 0.1 * moves
        innovation(constants, state, state.extent.dtype.type(1e-3 * draw.standard_normal()))
        assert state.variance >= constants.noise
        assert (state.covariance.variances >= 0.0).all()
        assert np.isfinite(state.theta).all()


@pytest.mark.parametrize("huge", [1e200, math.inf, math.nan])
def test_an_overflow_is_forgotten(huge: float) -> None:
    constants, state = begun()
    fresh_constants, fresh = begun()
    for value in (0.1, huge, -huge):
        state.regressor[:] = value
        state.extent, state.change, state.remainder = value, value, 0.0
        innovation(constants, state, value)
    clear_mismatch(fresh_constants, fresh)
    assert state.theta.tolist() == [0.0] * MAX_STATES
    assert state.covariance.variances.tolist() == fresh.covariance.variances.tolist()
    assert not state.covariance.upper.any()


def predicted(parameters: int, ticks: int = 400, **changes: Any) -> tuple[Record, Any, Any, Any]:
    """A table, random commands, G1 u1 by the model, and what ``predict_mismatch`` made of them.

    The last has a row a tick: regressor, extent, M and the remainder's variance.
    """
    target = Target(TICK_S, 0, "zoh", noise_rms=NOISE_RMS, noise_pole=COLOUR,
                    mismatch=other_cars(parameters), **changes)  # fmt: skip
    table = build(DESIGN, target)
    state = controller.init(table)[0].mismatch
    u = np.cumsum(np.random.default_rng(4).standard_normal(ticks))
    modelled = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, u)
    rows = []
    for command, model in zip(u, modelled, strict=True):
        predict_mismatch(table.mismatch, state, command, model)
        rows.append([*state.regressor, state.extent, state.change, state.remainder])
        advance_cars(table.mismatch, state, command)
    return table, u, modelled, np.array(rows)


@pytest.mark.parametrize("parameters", [1, 2, 3])
def test_x_is_the_difference_of_the_cars_whitened(parameters: int) -> None:
    _, u, modelled, rows = predicted(parameters)
    cars = other_cars(parameters).cars
    assert len(cars) == parameters
    for i, car in enumerate(cars):
        x = (signal.sosfilt(zoh(car, TICK_S).sos, u) - modelled) / 0.05
        whitened = signal.lfilter([1.0, -COLOUR], [1.0], x)
        np.testing.assert_allclose(rows[:, i], whitened, atol=1e-10 * np.abs(x).max())
    np.testing.assert_allclose(rows[:, parameters], 1.0 - COLOUR)  # of the remainder
    assert not rows[:, parameters + 1 : MAX_STATES].any()


def fading_largest(values: NDArray[Any]) -> NDArray[Any]:
    """max over j <= k of values[j] exp(-2 (k - j) T/1 s)."""
    k = np.arange(len(values))
    faded = values * np.exp(-2.0 * TICK_S * (k[:, None] - k))
    return np.where(k[:, None] >= k, faded, 0.0).max(axis=1)


def test_motion_is_measured_against_extent() -> None:
    _, u, modelled, rows = predicted(2)
    x = [(signal.sosfilt(zoh(g1, TICK_S).sos, u) - modelled) / 0.05 for g1 in other_cars(2).cars]
    extent = sum(value**2 for value in x)
    change = sum(np.diff(value, prepend=0.0) ** 2 for value in x) * (0.12 / TICK_S) ** 2
    remainder = 0.04 * 0.36 * fading_largest(change)
    for ours, expected in zip(
        rows[:, MAX_STATES:].T, (fading_largest(extent), fading_largest(change), remainder),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-12 * expected.max())


def test_a_rule_that_is_not_exact_leaves_a_tick_s_change_of_the_model() -> None:
    """Without other cars: the remainder alone, for a rule that lags or leads by up to a tick."""
    table, _, modelled, rows = predicted(0)
    assert (table.mismatch.cars, table.mismatch.n) == (0, 0)
    assert not rows.any()
    table = build(DESIGN, Target(TICK_S, 0, "tustin-held"))
    assert (table.mismatch.cars, table.mismatch.n) == (0, 1)
    state, seen = controller.init(table)[0].mismatch, []
    for model in modelled:
        predict_mismatch(table.mismatch, state, 0.0, model)
        seen.append(float(state.remainder))
    steps = np.diff(modelled, prepend=0.0) ** 2
    np.testing.assert_allclose(seen, fading_largest(steps), rtol=1e-9, atol=1e-300)


def test_what_is_not_finite_stays_in_no_memory() -> None:
    constants, state = begun(cars=0, n=1, rule=1.0, fading=0.9)
    for model in (1e200, 0.0):
        predict_mismatch(constants, state, 0.0, model)
        assert state.remainder == 0.0


@pytest.mark.parametrize("place", [(0.5, 0.0), (-0.7, 0.4)])
def test_theta_finds_the_place_of_a_car(place: tuple[float, float]) -> None:
    """A car that lies along the directions exactly, and noise: θ to within its own deviation."""
    table, u, modelled, _ = predicted(2)
    cars = other_cars(2).cars
    x = [(signal.sosfilt(zoh(g1, TICK_S).sos, u) - modelled) / 0.05 for g1 in cars]
    noise = 1e-5 * np.random.default_rng(5).standard_normal(len(u))
    difference = place[0] * x[0] + place[1] * x[1] + noise
    constants, state = begun(
        cars=2, n=3, noise=1e-10, colour=0.0, forgetting=0.0, growth=0.0, scale=20.0,
        car_1=table.mismatch.car_1, car_2=table.mismatch.car_2, white=0.0,
    )  # fmt: skip
    for command, model, residual in zip(u, modelled, difference, strict=True):
        predict_mismatch(constants, state, command, model)
        innovation(constants, state, residual)
        advance_cars(constants, state, command)
    factor = np.triu(state.covariance.upper, 1) + np.eye(MAX_STATES)
    deviation = np.sqrt(np.diag(factor * state.covariance.variances @ factor.T))[:2]
    assert (np.abs(state.theta[:2] - place) < 4.0 * deviation).all()
    assert deviation.max() < 0.05


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_innovations_of_coloured_noise_on_another_car_are_white_and_as_large_as_said(
    colour: float,
) -> None:
    """A car within the box, that does not wander: S is what its innovations have in the mean."""
    ticks, draw = 3000, np.random.default_rng(7)
    of = Target(TICK_S, 0, "zoh", noise_rms=0.01, noise_pole=colour, mismatch=other_cars(2))
    constants = np.array(build(DESIGN, of).mismatch)[()].copy()
    constants["forgetting"] = constants["growth"] = constants["white"] = 0.0
    u = 30.0 * np.sin(0.02 * np.arange(ticks))
    modelled = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, u)
    noise = signal.lfilter(
        [0.01 * math.sqrt(1.0 - colour**2)], [1.0, -colour], draw.standard_normal(ticks)
    )
    x = [(signal.sosfilt(zoh(g1, TICK_S).sos, u) - modelled) / 0.05 for g1 in other_cars(2).cars]
    constants, state = begun(**{name: constants[name] for name in constants.dtype.names})
    new = []
    for k, residual in enumerate(noise + 0.6 * x[0] - 0.3 * x[1]):
        predict_mismatch(constants, state, u[k], modelled[k])
        value = innovation(constants, state, residual)
        new.append(value / math.sqrt(state.variance))
        advance_cars(constants, state, u[k])
    normal = np.array(new[200:])
    assert normal.var() == pytest.approx(1.0, abs=0.1)
    for lag in (1, 2, 5):
        assert abs(np.mean(normal[lag:] * normal[:-lag])) < 4.0 / math.sqrt(ticks)


def test_settled_cars_stay_where_they_are() -> None:
    """In a steady bend: x is that of the steady state, and nothing moves."""
    table, *_ = predicted(2)
    state = controller.init(table)[0].mismatch
    torque = 1.0 / CAR.g1.dc_gain
    settle_mismatch(table.mismatch, state, torque, 1.0)
    for _ in range(5):
        predict_mismatch(table.mismatch, state, torque, 1.0)
        advance_cars(table.mismatch, state, torque)
    for i, car in enumerate(other_cars(2).cars):
        x = (car.dc_gain * torque - 1.0) / 0.05
        assert state.x[i] == pytest.approx(x, rel=1e-9)
    assert state.change == pytest.approx(0.0, abs=1e-9 * state.extent)
    assert state.remainder == pytest.approx(0.0, abs=1e-9 * state.extent)
