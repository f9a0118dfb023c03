"""A sensor's error that has been found is taken out of d̂ as if it had never been in it."""

from typing import Any

import numpy as np
import pytest

from firmware_model.law import controller
from firmware_model.law.core import biquad
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
    answers = np.zeros(len(values) + 2)
    for k, value in enumerate(values):
        answers[k + 2] = 0.05 * value + 1.6 * answers[k + 1] - 0.65 * answers[k]
    return answers[2:]


def filtered(table: Any, state: Any, residual: FloatArray, x: FloatArray) -> list[float]:
    own = state.supervision
    rows, n = [], int(table.mismatch.n)
    for value, row in zip(residual.tolist(), x, strict=True):
        own.mismatch.regressor[:n] = row
        rows.append(float(innovation(table.mismatch, own.mismatch, value, 0.0, 0.0, 0.0)))
    return rows


@pytest.mark.parametrize("lags", [False, True])
@pytest.mark.parametrize("name", ["sensor_biased", "sensor_drifting"])
def test_what_follows_is_what_would_have_been_without_the_error(name, lags):
    """Innovations, θ and gains: the filter has forgotten the error, and gets none any more."""
    table = with_one_onset(mismatch=other_cars(3), noise_pole=0.6)
    if lags:
        table = with_lags(table)
    draw = np.random.default_rng(5)
    x = draw.standard_normal((TICKS, int(table.mismatch.n)))
    healthy, size = 1e-4 * draw.standard_normal(TICKS), 0.3
    error = np.full(TICKS, size)
    if name == "sensor_drifting":  # it stops when it is found
        error *= np.minimum(np.arange(TICKS) + 1.0, FOUND)
    shown = through_lags(error) if lags else error
    fresh = controller.init(table)[0]
    without = filtered(table, fresh, healthy, x)
    state, rows = controller.init(table)[0], []
    own = state.supervision.hypotheses.signatures
    own.rows[DRIFT_ROW].ramp, n = -1.0, int(table.mismatch.n)  # onset: the first tick
    for k in range(TICKS):
        known = sensor_error_shown(table, state.supervision.hypotheses.sensor_error)
        state.supervision.mismatch.regressor[:n] = x[k]
        new = innovation(
            table.mismatch, state.supervision.mismatch, healthy[k] - shown[k], known, 0.0, 0.0
        )
        rows.append(new)
        weigh(table, state, new)
        if k == FOUND - 1:
            own.rows[ROW[name]].candidate["size_now"] = size
            ramp = own.rows[DRIFT_ROW].ramp if name == "sensor_drifting" else -1.0
            assert not learn_sensor_error(
                table,
                state.supervision.hypotheses.sensor_error,
                state.supervision.mismatch,
                own.rows[ROW[name]],
                ramp,
            )
            begin_all(own)
        tick_on(table, state)
        advance_sensor_error(table, state.supervision.hypotheses.sensor_error)
    assert state.supervision.hypotheses.sensor_error.offset == pytest.approx(error[-1])
    np.testing.assert_allclose(rows[FOUND:], without[FOUND:], rtol=1e-6, atol=1e-11)
    np.testing.assert_allclose(
        state.supervision.mismatch.theta, fresh.supervision.mismatch.theta, rtol=1e-6, atol=1e-11
    )
    assert np.abs(np.array(rows[:FOUND]) - without[:FOUND]).max() > 0.1


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
    table, ends = with_one_onset(mismatch=other_cars(3), noise_pole=0.6), 40
    if lags:
        table = with_lags(table)
    draw = np.random.default_rng(5)
    x = draw.standard_normal((TICKS, int(table.mismatch.n)))
    healthy, size = 1e-4 * draw.standard_normal(TICKS), 0.3
    error = np.where(np.arange(TICKS) < ends, size, 0.0)
    shown = through_lags(error) if lags else error
    without = filtered(table, controller.init(table)[0], healthy, x)
    state, rows = controller.init(table)[0], []
    own, known = state.supervision.hypotheses.signatures, state.supervision.hypotheses.sensor_error
    biased, n = own.rows[BIAS_ROW], int(table.mismatch.n)
    own.rows[DRIFT_ROW].ramp = -1.0
    for k in range(TICKS):
        told = sensor_error_shown(table, known)
        state.supervision.mismatch.regressor[:n] = x[k]
        rows.append(
            innovation(
                table.mismatch, state.supervision.mismatch, healthy[k] - shown[k], told, 0.0, 0.0
            )
        )
        weigh(table, state, rows[-1])
        if k in (FOUND - 1, ends):
            biased.candidate["size_now"] = size if k < ends else -size
            over = learn_sensor_error(table, known, state.supervision.mismatch, biased, -1.0)
            assert over == (k == ends)
            begin_all(own)
        tick_on(table, state)
        advance_sensor_error(table, known)
        if k == ends - 1:
            begin_all(own)
    assert known.offset == 0.0
    np.testing.assert_allclose(rows[ends + 1 :], without[ends + 1 :], rtol=1e-6, atol=1e-11)


def test_lags_of_these_tests_are_those_of_the_section():
    table = with_lags(with_one_onset())
    memory, u = biquad.at_rest(), np.random.default_rng(1).standard_normal(30)
    m = table.estimator.measurement
    answers = [biquad.advance(m, memory, value) for value in u]
    np.testing.assert_allclose(answers, through_lags(u), rtol=1e-12, atol=1e-14)
