"""When the onset of a hypothesis is now: to the last number, and with nothing of the last onset."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import signal, stats

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.supervision.candidate import has_failed, start, take_in
from firmware_model.law.supervision.signatures import (
    BIAS_ROW,
    DRIFT_ROW,
    FORCE_ROW,
    OFFSET_ROW,
    answers_no_more,
)
from tests.firmware.law.cases import CAR, DESIGN, ROW, TICK_S, changed, repeat, tick_on, weigh

pytestmark = pytest.mark.every_case  # a case each of few lines

TABLE = build(DESIGN, Target(TICK_S, 1, "zoh", noise_rms=0.01))
BELOW, ABOVE = math.nextafter(1.0, 0.0), math.nextafter(1.0, 2.0)
LAGS = 0.05, 0.1, 0.05, 0.4, 0.05  # an M, as a section in δ has it


def begun(variance: float = 1.0) -> tuple[Any, Any]:
    """A filter that knows the car: a fault shows by its change of the innovations."""
    table = changed(TABLE)[0]
    table.mismatch.n = 0
    numbers = table.hypotheses.signatures.candidate
    numbers.restart, numbers.lifetime, numbers.promising = -1.0, 1000.0, 8.0
    state = controller.init(table)[0]
    state.supervision.mismatch.variance = variance
    return table, state


def test_what_is_predicted_is_told_with_the_size_of_the_tick_before():
    """Against the densities of white noise; the size is that of a weighted regression."""
    table, state = begun()
    draw = np.random.default_rng(3)
    f, sigma = draw.standard_normal(12), draw.uniform(0.5, 2.0, 12)
    new = 0.7 * f + sigma * draw.standard_normal(12)
    own = state.supervision.hypotheses.signatures.rows[OFFSET_ROW].candidate
    limits = table.hypotheses.signatures.rows[OFFSET_ROW].limits
    for k in range(12):
        state.supervision.mismatch.variance = sigma[k] ** 2
        take_in(table.mismatch, state.supervision.mismatch, own, limits, float(f[k]), float(new[k]))
    fitted = np.cumsum(f * new / sigma**2) / np.cumsum(f**2 / sigma**2)
    before = np.concatenate([[0.0], fitted[:-1]])
    predicted = stats.norm.logpdf(new, before * f, sigma) - stats.norm.logpdf(new, 0.0, sigma)
    assert own.predicted == pytest.approx(predicted.sum(), rel=1e-9)


@pytest.mark.parametrize(
    ("age", "evidence", "predicted", "failed"),
    [(1.0, 0.0, -1.0, True), (1.0, 0.0, -BELOW, False), (10.0, 0.0, math.nan, True),
     (10.0, math.nan, 0.0, True), (1000.0, 8.0, 0.0, True), (1000.0, 8.0 * ABOVE, 0.0, False),
     (1000.0 * BELOW, 8.0, 0.0, False), (5000.0 * BELOW, 1e9, 1e9, False),
     (5000.0, 1e9, 1e9, True)],
)  # fmt: skip
def test_the_last_number_with_which_a_candidate_is_given_up(age, evidence, predicted, failed):
    table, state = begun()
    own = state.supervision.hypotheses.signatures.rows[OFFSET_ROW].candidate
    own.age, own.evidence, own.predicted = age, evidence, predicted
    assert has_failed(table.hypotheses.signatures.candidate, own) == failed


def test_a_candidate_that_begins_knows_nothing_of_the_last():
    _, state = begun()
    own = state.supervision.hypotheses.signatures.rows[OFFSET_ROW].candidate
    fresh = own.tobytes()
    for name in own.dtype.names:
        own[name] = 7.0
    start(own)
    assert own.tobytes() == fresh


@pytest.mark.parametrize("name", ["torque_offset", "force_lost"])
def test_a_fault_of_an_actuator_begins_again_where_its_onset_was_none(name):
    """And what channel 2 was told, and did not do, is counted from the same onset."""
    table, state = begun()
    own = state.supervision.hypotheses.signatures
    fresh = own.rows[ROW[name]].tobytes()
    own.rows[ROW[name]].candidate.predicted = -2.0
    own.rows[ROW[name]].answer.accumulators[:] = own.commanded = own.missing = own.before = 7.0
    state.supervision.sequential_test.candidate.age = 3.0
    weigh(table, state, 0.0)
    assert own.rows[ROW[name]].tobytes() == fresh
    assert (own.commanded == own.missing == own.before == 0.0) == (name == "force_lost")


def test_the_evidence_of_before_is_that_at_the_last_onset_of_a_loss_of_channel_1():
    table, state = begun()
    own, evidence = state.supervision.hypotheses.signatures, []
    for age in (4.0, 0.0, 1.0, 2.0):
        state.supervision.other_cars.command_2, state.supervision.sequential_test.candidate.age = (
            1000.0,
            age,
        )
        weigh(table, state, 0.5)
        tick_on(table, state)
        evidence.append(float(own.rows[FORCE_ROW].candidate.evidence))
        assert own.before == (evidence[1] if len(evidence) > 1 else 0.0)
    assert evidence == sorted(set(evidence))


def test_what_channel_2_was_told_and_what_of_it_is_missing():
    """By scipy's model of the channel: Σ (G2 u2)² and Σ G2 u2 d̂."""
    table, state = begun()
    table.hypotheses.signatures.candidate.restart = -math.inf
    own, draw = state.supervision.hypotheses.signatures, np.random.default_rng(1)
    force, residual = 1000.0 * draw.standard_normal(40), draw.standard_normal(40)
    for command, d_hat in zip(force, residual, strict=True):
        state.supervision.other_cars.command_2, state.supervision.mismatch.previous_residual = (
            command,
            d_hat,
        )
        weigh(table, state, 0.0)
        tick_on(table, state)
    g2 = CAR.g2.numerator(), CAR.g2.denominator()
    told = signal.dlsim(signal.cont2discrete(g2, TICK_S), force)[1].ravel()
    assert own.commanded == pytest.approx(told @ told, rel=1e-4)
    assert own.missing == pytest.approx(told @ residual, rel=1e-4)


@pytest.mark.parametrize(("missing", "gone"), [(0.5, False), (2.0, False), (2.01, True)])
def test_channel_2_answers_no_more_where_more_than_half_is_missing(missing, gone):
    own = begun()[1].supervision.hypotheses.signatures
    own.commanded, own.missing = 4.0, missing
    assert answers_no_more(own) == gone


def test_an_offset_takes_away_from_a_plant_that_answers_at_once_too():
    table, state = begun()
    table.estimator.channel_1.n = 1
    table.estimator.channel_1.coefficients[0] = 0.5, 0.0, 0.0, 0.0, 0.0
    state.supervision.mismatch.variance = 1.0
    weigh(table, state, 1.0)
    assert state.supervision.hypotheses.signatures.rows[OFFSET_ROW].candidate.correlation == -0.5


@pytest.mark.parametrize("name", ["sensor_biased", "sensor_drifting"])
@pytest.mark.parametrize(
    ("fresh", "predicted", "begins"),
    [(0.9, 0.0, False), (1.1, 0.0, True), (0.9, -2.0, True), (1.1, -2.0, True)],
)
def test_a_sensor_errs_from_now_on_where_this_tick_alone_explains_more(
    name, fresh, predicted, begins
):
    """Than the evidence of 1, about which so much is known that a tick adds nothing.

    Or where the onset was none. From rest M shows β0 of it at once.
    """
    table, state = begun(variance=0.25)
    table.estimator.measurement.n = 1
    table.estimator.measurement.coefficients[0] = LAGS
    own, new = state.supervision.hypotheses.signatures, math.sqrt(2.0 * 0.25 * fresh)
    own.rows[DRIFT_ROW].ramp, candidate = -10.0, own.rows[ROW[name]].candidate
    candidate.information, candidate.correlation = 1e9, math.sqrt(2.0 * 1e9)
    candidate.age, candidate.predicted = 10.0, predicted
    own.rows[ROW[name]].answer.accumulators[0, 0] = 7.0
    weigh(table, state, new)
    if begins:
        assert candidate.age == 1.0
        assert candidate.information == pytest.approx(0.05**2 / 0.25)
        assert candidate.correlation == pytest.approx(-0.05 * new / 0.25)
        assert not own.rows[ROW[name]].answer.accumulators.any()
    else:
        assert candidate.age == 11.0
        assert own.rows[ROW[name]].answer.accumulators[0, 0] == 7.0
    if name == "sensor_drifting":
        assert own.rows[DRIFT_ROW].ramp == (-1.0 if begins else -10.0)


def test_a_tick_that_explains_as_much_as_all_before_is_no_onset():
    """Of 1, 0, 0, 1 a bias of a half explains ½ · 2²/4, and the last alone ½ · 1²."""
    table, state = begun()
    for new in (1.0, 0.0, 0.0, 1.0):
        weigh(table, state, new)
    candidate = state.supervision.hypotheses.signatures.rows[BIAS_ROW].candidate
    assert (candidate.age, candidate.evidence) == (4.0, 0.5)


@pytest.mark.parametrize(
    ("moved", "tells"),
    [(0.25, False), (0.25 * ABOVE, True), (-0.25, False), (-0.25 * ABOVE, True), (0.0, False)],
)
def test_a_repetition_tells_something_where_the_model_has_moved_by_more_than_the_least(
    moved, tells
):
    """Either way, since the number came, and no longer than it has; of a d̂ that has not moved."""
    table, state = begun(variance=0.04)
    constants, own = table.hypotheses.frozen, state.supervision.hypotheses.frozen
    constants.least_motion, constants.repetition = 0.25, 3.0
    start_at, far = 0.0 if tells else 2.0, 1.0
    state.measurement = 0.3
    path = [start_at, start_at + far, start_at + moved]
    for expected in path:
        repeat(table, state, 0.0, expected)
    missing = np.array([far, moved])
    ratio = stats.norm.logpdf(0.0, missing, 0.2) - stats.norm.logpdf(0.0, 0.0, 0.2)
    assert own.candidate.information == pytest.approx(missing @ missing / 0.04)
    assert own.evidence == pytest.approx(2 * 3.0 + ratio.sum() if tells else 0.0)
    fresh = controller.init(table)[0].supervision.hypotheses.frozen.candidate
    state.measurement = 0.31
    repeat(table, state, 0.0, 0.0)
    assert own.candidate.tobytes() == fresh.tobytes()


def test_of_a_plant_that_is_not_stable_no_motion_is_missing():
    """There the model says M y, which is not where y is: only the repetitions count."""
    table, state = begun()
    table.estimator.measurement.n = 1
    table.estimator.measurement.coefficients[0] = LAGS
    table.hypotheses.frozen.least_motion, table.hypotheses.frozen.repetition = 0.25, 3.0
    state.measurement = 0.3
    for expected in (0.0, 1.0, 2.0):
        repeat(table, state, 0.5, expected)
    own = state.supervision.hypotheses.frozen
    assert (own.candidate.information, own.candidate.evidence, own.evidence) == (0.0, 0.0, 6.0)
