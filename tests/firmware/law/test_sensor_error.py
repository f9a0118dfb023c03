"""A sensor's error that has been found is taken out of d̂ as if it had never been in it."""

from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.law import controller
from firmware_model.law.structs import FloatArray
from firmware_model.law.supervision.mismatch import innovation
from firmware_model.law.supervision.sensor_error import (
    advance_sensor_error,
    learn_sensor_error,
    sensor_error_shown,
)
from firmware_model.law.supervision.signatures import BIAS_ROW, DRIFT_ROW, begin_all
from tests.firmware.law.cases import ROW, other_cars, tick_on, weigh, with_one_onset

TICKS, FOUND = 60, 25


def with_lags(table: Any) -> Any:
    """The same with an M: 0.05 z²/(z² - 1.6 z + 0.65), as sections in δ have it."""
    table.estimator.measurement.n = 1
    table.estimator.measurement.coefficients[0] = 0.05, 0.1, 0.05, 0.4, 0.05
    return table


def through_lags(values: FloatArray) -> FloatArray:
    return np.asarray(signal.lfilter([0.05], [1.0, -1.6, 0.65], values))


def filtered(
    table: Any, state: Any, residual: FloatArray, x: FloatArray, known: float = 0.0
) -> list[float]:
    own = state.supervision.mismatch
    rows, n = [], int(table.mismatch.n)
    for value, row in zip(residual.tolist(), x, strict=True):
        own.regressor[:n] = row
        rows.append(float(innovation(table.mismatch, own, value, known, 0.0, 0.0)))
    return rows


def erring(
    name: str, lags: bool, error: FloatArray, finds: dict[int, tuple[float, bool]], onset: int = 0
) -> tuple[FloatArray, FloatArray, Any, Any]:
    """Innovations with and without the error of a sensor, and both states.

    In the ticks ``finds`` the hypothesis ``name`` has that size, and then the error is over or not;
    its onset is the first tick, and ``onset``.
    """
    table = with_one_onset(mismatch=other_cars(3), noise_pole=0.6)
    if lags:
        table = with_lags(table)
    draw = np.random.default_rng(5)
    x = draw.standard_normal((TICKS, int(table.mismatch.n)))
    healthy = 1e-4 * draw.standard_normal(TICKS)
    shown = through_lags(error) if lags else error
    fresh, state, rows = controller.init(table)[0], controller.init(table)[0], []
    without = filtered(table, fresh, healthy, x)
    own = state.supervision.hypotheses
    row, drift = own.signatures.rows[ROW[name]], own.signatures.rows[DRIFT_ROW]
    drift.ramp = -1.0
    for k in range(TICKS):
        known = sensor_error_shown(table, own.sensor_error)
        rows += filtered(table, state, healthy[[k]] - shown[[k]], x[[k]], known)
        weigh(table, state, rows[-1])
        if k in finds:
            row.candidate["size_now"], over = finds[k]
            ramp = drift.ramp if name == "sensor_drifting" else -1.0
            known = state.supervision.mismatch
            assert learn_sensor_error(table, own.sensor_error, known, row, ramp) == over
            begin_all(own.signatures)
        tick_on(table, state)
        advance_sensor_error(table, own.sensor_error)
        if k == onset - 1:
            begin_all(own.signatures)
    return np.array(rows), np.array(without), state.supervision, fresh.supervision


@pytest.mark.parametrize("lags", [False, True])
@pytest.mark.parametrize("name", ["sensor_biased", "sensor_drifting"])
def test_what_follows_is_what_would_have_been_without_the_error(name, lags):
    """Innovations, θ and gains: the filter has forgotten the error, and gets none any more."""
    size = 0.3
    error = np.full(TICKS, size)
    if name == "sensor_drifting":  # it stops when it is found
        error *= np.minimum(np.arange(TICKS) + 1.0, FOUND)
    rows, without, state, fresh = erring(name, lags, error, {FOUND - 1: (size, False)})
    assert state.hypotheses.sensor_error.offset == pytest.approx(error[-1])
    np.testing.assert_allclose(rows[FOUND:], without[FOUND:], rtol=1e-6, atol=1e-11)
    np.testing.assert_allclose(state.mismatch.theta, fresh.mismatch.theta, rtol=1e-6, atol=1e-11)
    assert np.abs(rows[:FOUND] - without[:FOUND]).max() > 0.1


@pytest.mark.every_case
@pytest.mark.parametrize(
    ("sizes", "gone"),
    [
        ([0.1], False),
        ([0.1, -0.04], False),
        ([0.1, -0.06], True),
        ([0.1, 0.1, -0.1], False),
        ([0.1, -0.21], False),  # as large on the other side
        ([-0.1, 0.04], False),
        ([-0.1, 0.06], True),
    ],
)
def test_an_error_is_gone_where_less_than_half_is_left(sizes, gone):
    table = with_one_onset()
    state = controller.init(table)[0].supervision
    biased = state.hypotheses.signatures.rows[BIAS_ROW]
    for size in sizes:
        biased.candidate["size_now"] = size
        over = learn_sensor_error(
            table, state.hypotheses.sensor_error, state.mismatch, biased, -1.0
        )
    assert over == gone
    assert state.hypotheses.sensor_error.offset == pytest.approx(0.0 if gone else sum(sizes))


@pytest.mark.parametrize("lags", [False, True])
def test_an_error_that_ends_leaves_nothing(lags):
    """Known from FOUND on, ended at tick 40, found to be over there: from then on as without it."""
    size, ends = 0.3, 40
    error = np.where(np.arange(TICKS) < ends, size, 0.0)
    finds = {FOUND - 1: (size, False), ends: (-size, True)}
    rows, without, state, _ = erring("sensor_biased", lags, error, finds, onset=ends)
    assert state.hypotheses.sensor_error.offset == 0.0
    np.testing.assert_allclose(rows[ends + 1 :], without[ends + 1 :], rtol=1e-6, atol=1e-11)
