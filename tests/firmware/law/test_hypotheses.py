"""One hypothesis: its signature in the innovations, its evidence, its onset."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import optimize, signal, stats

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.structs import FloatArray
from firmware_model.law.supervision.candidate import likeliest, take_in
from firmware_model.law.supervision.mismatch import innovation
from firmware_model.law.supervision.signatures import BIAS_ROW, FORCE_ROW, begin_all
from tests.firmware.law.cases import (
    CAR,
    DESIGN,
    ROW,
    TICK_S,
    other_cars,
    repeat,
    tick_on,
    weigh,
    with_one_onset,
)

TICKS = 60


NO_CARS = with_one_onset()
NO_CARS.mismatch.n = 0


def filtered(table: Any, residual: FloatArray, x: FloatArray) -> tuple[FloatArray, Any]:
    """The innovations of a residual, where other cars show x; and the filter that made them."""
    state = controller.init(table)[0]
    n, rows = int(table.mismatch.n), []
    for k, value in enumerate(residual.tolist()):
        state.supervision.mismatch.regressor[:n] = x[k, :n]
        rows.append(innovation(table.mismatch, state.supervision.mismatch, value, 0.0, 0.0, 0.0))
    return np.array(rows), state


@pytest.mark.parametrize("noise_pole", [0.0, 0.6])
def test_a_signature_is_what_the_fault_changes_in_the_innovations(noise_pole):
    """The filter is linear in d̂: with and without the fault its innovations differ by m f."""
    table = with_one_onset(mismatch=other_cars(3), noise_pole=noise_pole)
    draw = np.random.default_rng(3)
    n, size = int(table.mismatch.n), 0.7
    x = draw.standard_normal((TICKS, n))
    shown = np.cumsum(draw.standard_normal(TICKS))
    healthy = draw.standard_normal(TICKS)
    without, _ = filtered(table, healthy, x)
    with_fault, _ = filtered(table, healthy + size * shown, x)
    state = controller.init(table)[0].supervision
    own = state.hypotheses.signatures.rows[BIAS_ROW].candidate
    limits = table.hypotheses.signatures.rows[BIAS_ROW].limits
    correlation = information = 0.0
    for k in range(TICKS):
        state.mismatch.regressor[:n] = x[k]
        residual = float(healthy[k] + size * shown[k])
        new = innovation(table.mismatch, state.mismatch, residual, 0.0, 0.0, 0.0)
        assert new == pytest.approx(with_fault[k], rel=1e-12)
        take_in(table.mismatch, state.mismatch, own, limits, float(shown[k]), new)
        f = (with_fault[k] - without[k]) / size
        correlation += f * new / state.mismatch.variance
        information += f * f / state.mismatch.variance
    assert own.correlation == pytest.approx(correlation, rel=1e-8)
    assert own.information == pytest.approx(information, rel=1e-8)


@given(new=st.floats(0.1, 10.0), variance=st.floats(0.01, 1.0))
def test_a_bias_jumps_in_the_tick_after_a_verdict_as_in_any_other(new, variance):
    """Its onset is that tick already, so it begins again or not as the last bit falls."""
    table, state = NO_CARS, controller.init(NO_CARS)[0]
    own = state.supervision
    begin_all(own.hypotheses.signatures)
    own.mismatch.variance = variance
    weigh(table, state, new)
    assert own.hypotheses.signatures.jump == pytest.approx(0.5 * new**2 / variance, rel=1e-12)


@given(st.integers(0, 10**6), st.sampled_from([(-math.inf, math.inf), (0.5, 1.5), (-0.1, 0.1)]))
def test_evidence_is_the_likelihood_ratio_of_the_likeliest_size(seed, limits):
    """Against the log-densities of white noise, and scipy's search for the size."""
    draw = np.random.default_rng(seed)
    f, sigma = draw.standard_normal(12), draw.uniform(0.5, 2.0, 12)
    new = draw.uniform(-1, 1) * f + sigma * draw.standard_normal(12)
    table, state = NO_CARS, controller.init(NO_CARS)[0].supervision
    own, bounds = (
        state.hypotheses.signatures.rows[FORCE_ROW].candidate,
        table.hypotheses.torque_lost,
    )
    bounds.least, bounds.most = limits
    for k in range(12):
        state.mismatch.variance = sigma[k] ** 2
        take_in(table.mismatch, state.mismatch, own, bounds, float(f[k]), float(new[k]))

    def log_ratio(size: float) -> float:
        with_fault = stats.norm.logpdf(new, size * f, sigma).sum()
        return float(with_fault - stats.norm.logpdf(new, 0.0, sigma).sum())

    within = np.clip(limits, -10.0, 10.0)
    best = optimize.minimize_scalar(
        lambda m: -log_ratio(m), bounds=within, method="bounded", options={"xatol": 1e-9}
    )
    assert own.evidence == pytest.approx(log_ratio(float(own.size_now)), abs=1e-9)
    assert own.evidence == pytest.approx(-best.fun, abs=1e-6)


def test_where_nothing_is_known_the_size_is_none():
    limits = with_one_onset().hypotheses.signatures.rows[FORCE_ROW].limits
    assert likeliest(3.0, 0.0, limits) == 0.0
    assert likeliest(-3.0, 1.0, limits) == limits.least == 0.5


def test_what_each_fault_adds_to_the_estimate():
    """Against the step response of the continuous plant and a simulation by scipy's state space."""
    table, state = NO_CARS, controller.init(NO_CARS)[0]
    own = state.supervision.hypotheses.signatures
    state.supervision.mismatch.variance = 1.0
    draw = np.random.default_rng(1)
    force = 1000.0 * draw.standard_normal(TICKS)
    rows = []
    for k in range(TICKS):
        state.supervision.other_cars.command_2 = force[k]
        weigh(table, state, 0.0)
        rows.append(
            [own.rows[ROW[name]].candidate.information
             for name in ("torque_offset", "force_lost", "sensor_biased", "sensor_drifting")]
        )  # fmt: skip
        tick_on(table, state)
        if k == 0:  # the onset that is looked at: from now on
            begin_all(own)
            tick_on(table, state)
            rows = [[0.0] * 4]
    offset, lost, bias, drift = np.diff(rows, axis=0).T  # squares of the signatures
    t = TICK_S * np.arange(1, TICKS)
    g1, g2 = ((channel.numerator(), channel.denominator()) for channel in (CAR.g1, CAR.g2))
    _, expected = signal.step(g1, T=np.concatenate([[0.0], t]))
    np.testing.assert_allclose(offset, expected[1:] ** 2, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(bias, 1.0)
    np.testing.assert_array_equal(drift, np.arange(1, TICKS) ** 2)
    held = signal.dlsim(signal.cont2discrete(g2, TICK_S), force)[1].ravel()
    np.testing.assert_allclose(lost, held[1:] ** 2, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("moves", [False, True])
def test_a_frozen_sensor_repeats_itself_while_the_model_moves(moves):
    """Then -ln of the chance of each repetition, and the likelihood of the missing motion."""
    table = with_one_onset(resolution=0.001)
    state = controller.init(table)[0]
    table.mismatch.n = 0
    own = state.supervision.hypotheses.frozen
    state.supervision.mismatch.variance = 0.02**2
    expected = 0.1 * np.arange(6) if moves else np.zeros(6)
    for k in range(6):
        state.measurement = 0.3
        repeat(table, state, float(expected[k] - expected[0]), float(expected[k]))
    draw = np.random.default_rng(0).standard_normal((2, 400_000)) * 0.01
    chance = np.mean(np.diff(np.rint(draw / 0.001), axis=0) == 0.0)
    missing = expected[1:] - expected[0]
    ratio = stats.norm.logpdf(0.0, 0.0, 0.02) - stats.norm.logpdf(missing, 0.0, 0.02)
    assert own.repetitions == 5.0
    evidence = -5.0 * math.log(chance) + ratio.sum() if moves else 0.0
    assert own.evidence == pytest.approx(evidence, rel=0.02)
    state.measurement = 0.301
    repeat(table, state, 0.0, 0.0)
    assert (own.repetitions, own.evidence) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("noise_rms", "resolution", "evidence"),
    [(0.0, 0.0, 0.0), (0.0, 0.01, 0.0), (0.001, 0.01, 0.0), (0.01, 0.0, math.log(1e6))],
)
def test_a_repetition_says_nothing_without_noise_and_no_more_than_a_sensor_resolves(
    noise_rms, resolution, evidence
):
    table = build(DESIGN, Target(TICK_S, 1, "zoh", noise_rms=noise_rms, resolution=resolution))
    assert table.hypotheses.frozen.repetition == pytest.approx(evidence)
    assert math.isfinite(table.hypotheses.frozen.least_motion) == (evidence > 0.0)
