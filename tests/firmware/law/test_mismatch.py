"""What is learnt of the car: x by scipy's filters, and what θ and its variance make of it."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.law import controller
from firmware_model.law.layout import Table
from firmware_model.law.structs import Records
from firmware_model.law.supervision.covariance import MAX_STATES
from firmware_model.law.supervision.mismatch import (
    difference,
    doubt_motion,
    innovation,
    learn_loss,
    predict_mismatch,
    settle_mismatch,
)
from firmware_model.law.supervision.other_cars import (
    advance_other_cars,
    settle_other_cars,
    show_other_cars,
)
from tests.firmware.law.cases import CAR, DESIGN, TICK_S, changed, covariance_of, other_cars

COLOUR, NOISE_RMS = 0.6, 0.01
REMAINDER = abs(1.0 - COLOUR * np.exp(-1j * TICK_S / 0.12))  # W at its time constant


def tables_of(parameters: int, **changes: Any) -> Records[Table]:
    of = {"noise_rms": NOISE_RMS, "noise_pole": COLOUR, **changes}
    mismatch = other_cars(parameters)
    return changed(build(DESIGN, Target(TICK_S, 0, "zoh", mismatch=mismatch, **of)))


COMMANDS = np.cumsum(np.random.default_rng(4).standard_normal(100))
MODELLED = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, COMMANDS)
LOST, EARLIER = np.random.default_rng(5).standard_normal((2, 100))


def differences(parameters: int, u: NDArray[Any] = COMMANDS) -> list[NDArray[Any]]:
    """x of commands 1 alone, by scipy."""
    modelled = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, u)
    return [
        (signal.sosfilt(zoh(g1, TICK_S).sos, u) - modelled) / 0.05
        for g1, _ in other_cars(parameters).cars
    ]


def predict(
    table: Any, state: Any, command: float, model: float, lost: float, earlier: float = 0.0
) -> None:
    """A tick of the other cars and of the mismatch."""
    own = state.supervision
    show_other_cars(table, own.other_cars, state.estimator.measured, command, 0.0)
    predict_mismatch(table, own.mismatch, own.other_cars.shown, model, lost, earlier)
    advance_other_cars(table, own.other_cars, state.estimator.measured, state.command_2)


def predicted(table: Any) -> NDArray[Any]:
    """A row a tick: regressor, extent, M and the remainder's variance."""
    state, rows = controller.init(table)[0], []
    learn_loss(table.mismatch, state.supervision.mismatch, 0.09, 25.0)
    for drive in zip(COMMANDS, MODELLED, LOST, EARLIER, strict=True):
        predict(table, state, *drive)
        known = state.supervision.mismatch
        rows.append([*known.regressor, known.extent, known.change, known.remainder])
    return np.array(rows)


def whitened(x: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(signal.lfilter([1.0, -COLOUR], [1.0], x))


@pytest.mark.parametrize("parameters", [1, 2, 3, 4])
def test_x_is_the_lost_w_what_is_earlier_the_difference_of_the_cars_and_one_whitened(parameters):
    rows = predicted(tables_of(parameters)[0])
    np.testing.assert_allclose(rows[:, 0], whitened(LOST), atol=1e-12)
    np.testing.assert_allclose(rows[:, 1], whitened(EARLIER), atol=1e-12)
    for i, x in enumerate(differences(parameters), start=2):
        np.testing.assert_allclose(rows[:, i], whitened(x), atol=1e-10 * np.abs(x).max())
    np.testing.assert_allclose(rows[:, 2 + parameters], REMAINDER)
    assert not rows[:, parameters + 3 : MAX_STATES].any()


def test_the_lost_w_and_what_is_earlier_are_kept_for_the_tick_after():
    table = tables_of(1)[0]
    state = controller.init(table)[0]
    predict(table, state, 1.0, 0.5, 0.3, 0.2)
    assert state.supervision.mismatch.x[:2].tolist() == [0.3, 0.2]


def fading_largest(values: NDArray[Any]) -> NDArray[Any]:
    """max over j <= k of values[j] exp(-2 (k - j) T/1 s)."""
    k = np.arange(len(values))
    faded = values * np.exp(-2.0 * TICK_S * (k[:, None] - k))
    return np.where(k[:, None] >= k, faded, 0.0).max(axis=1)


def test_motion_is_measured_against_extent():
    """Of the cars alone: how much is lost says nothing of how the car moves."""
    rows, x = predicted(tables_of(2)[0]), differences(2)
    extent = sum(value**2 for value in x)
    change = sum(np.diff(value, prepend=0.0) ** 2 for value in x) * (0.12 / TICK_S) ** 2
    remainder = 0.01 * 0.36 * fading_largest(change)
    for ours, expected in zip(
        rows[:, MAX_STATES:].T, (fading_largest(extent), fading_largest(change), remainder),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-12 * expected.max())


def test_a_rule_that_is_not_exact_leaves_a_tick_s_change_of_the_model():
    """Without other cars: the remainder alone, for a rule that lags or leads by up to a tick."""
    exact = predicted(tables_of(0)[0])
    np.testing.assert_allclose(exact[:, 1], whitened(EARLIER), atol=1e-12)
    assert not exact[:, 2:].any()
    held = predicted(
        build(DESIGN, Target(TICK_S, 0, "tustin-held", noise_pole=COLOUR, noise_rms=NOISE_RMS))
    )
    np.testing.assert_allclose(held[:, 2], REMAINDER)
    steps = np.diff(MODELLED, prepend=0.0) ** 2
    np.testing.assert_allclose(held[:, -1], fading_largest(steps), rtol=1e-9, atol=1e-300)


def test_what_is_not_finite_stays_in_no_memory():
    table = build(DESIGN, Target(TICK_S, 0, "tustin-held"))
    state = controller.init(table)[0]
    for model in (1e200, 0.0):
        predict(table, state, 0.0, model, 0.0)
        assert state.supervision.mismatch.remainder == 0.0


def test_a_settled_car_has_not_moved():
    """In a steady bend: x is that of the steady state, and M is nothing."""
    table = tables_of(2)[0]
    state, torque = controller.init(table)[0], 1.0 / CAR.g1.dc_gain
    own = state.supervision
    known = own.mismatch
    known.theta[:] = known.x[:] = 7.0
    known.covariance.lower[:] = 0.3
    settle_other_cars(table, own.other_cars, state.estimator.measured, torque, 0.0)
    settle_mismatch(table, own.mismatch, own.other_cars.shown, 1.0)
    assert not known.theta.any()
    assert known.x[:2].tolist() == known.regressor[:2].tolist() == [0.0, 0.0]
    for _ in range(5):
        predict(table, state, torque, 1.0, 0.0)
    for x, (g1, _) in zip(known.x[2:], other_cars(2).cars, strict=False):
        assert x == pytest.approx((g1.dc_gain * torque - 1.0) / 0.05, rel=1e-9)
    assert known.change == pytest.approx(0.0, abs=1e-9 * known.extent)
    assert known.remainder == pytest.approx(0.0, abs=1e-9 * known.extent)
    assert np.diag(covariance_of(known)).tolist() == [0.0, 0.0, 0.36, 0.36, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("part", [1.0, 0.5, 0.1])
def test_the_remainder_is_of_second_order(part):
    """Of a car with ``part`` of the box's θ, known or not, it is the square of that."""
    table = tables_of(4)[0]
    state = controller.init(table)[0]
    known, cars = state.supervision.mismatch, slice(2, 6)
    known.covariance.variances[cars] = 0.36 * part**2
    known.covariance.variances[2] = 0.0
    known.theta[2] = 0.6 * part
    for command in (0.0, 1.0, 2.0, 3.0):
        predict(table, state, command, 0.0, 0.0)
    assert known.change > 0.0
    assert known.remainder == pytest.approx(0.01 * 0.36 * part**4 * known.change, rel=1e-9)


def test_a_car_beyond_the_box_is_as_different_as_the_box_at_most():
    table = tables_of(2)[0]
    state = controller.init(table)[0].supervision
    assert difference(table, state.mismatch) == 1.0  # nothing is known of it
    state.mismatch.theta[2:4] = 10.0
    assert difference(table, state.mismatch) == 1.0


def test_a_doubted_motion_is_a_remainder_of_that_variance():
    """The variance of the first innovation grows by x² times the variance, and its white share."""
    table = build(DESIGN, Target(TICK_S, 1, "zoh", mismatch=other_cars(2), noise_rms=0.01))
    variances = []
    for doubted in (0.0, 0.5):
        state = controller.init(table)[0]
        own = state.supervision
        doubt_motion(table.mismatch, own.mismatch, doubted)
        predict(table, state, 1.0, 0.0, 0.0)
        last = table.mismatch.n - 1
        shown = float(own.mismatch.regressor[last])
        innovation(table.mismatch, own.mismatch, 0.1, 0.0, 0.0, 0.0)
        white = float(table.mismatch.white * own.mismatch.remainder)
        variances.append(float(own.mismatch.variance) - doubted * shown**2 - white)
    assert shown > 0.0
    assert variances[0] == pytest.approx(variances[1], rel=1e-9)
