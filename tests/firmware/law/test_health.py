"""The end of known faults that d̂ does not show."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import signal

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.status import FaultState
from firmware_model.law.supervision.health import clear_health, is_healthy
from tests.firmware.law.cases import CAR, DESIGN, other_cars

TICK_S = 0.01
TABLE = build(
    design(CAR, DesignSpecification(tau_s=0.02, tau_q_s=0.05)),
    Target(TICK_S, 1, "zoh", noise_rms=0.01),
)
NUMBERS = TABLE.hypotheses.health
SECOND = round(1.0 / TICK_S)


def told(residuals, share, w, errors, begins=()):
    """What ``is_healthy`` says tick by tick; the sums begin anew in the ticks ``begins``."""
    own = controller.init(TABLE)[0].supervision.hypotheses.health
    says = []
    for k, (residual, lost, error) in enumerate(zip(residuals, w, errors, strict=True)):
        if k in begins:
            clear_health(own)
        says.append(is_healthy(NUMBERS, own, residual, share, lost, error))
    return np.array(says)


@pytest.mark.compiled
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 0.5))
def test_the_faults_end_where_memories_of_a_second_say_so(seed, share, shown, error):
    """Against sums written out, of a d̂ that shows any part of the known loss."""
    draw = np.random.default_rng(seed)
    w, errors = draw.standard_normal(3 * SECOND), error * draw.standard_normal(3 * SECOND)
    residuals = shown * share * w - errors * shown + 0.01 * draw.standard_normal(3 * SECOND)
    expected = []
    for k in range(3 * SECOND):
        fading = np.exp(-TICK_S * np.arange(k, -1, -1))
        faults = fading @ (max(share, 0.2) ** 2 * w[: k + 1] ** 2 + errors[: k + 1] ** 2)
        expected.append(k >= SECOND and 81.0 * (fading @ residuals[: k + 1] ** 2) < faults)
    np.testing.assert_array_equal(told(residuals, share, w, errors), expected)


def test_no_fault_ends_without_a_fault():
    nothing = np.zeros(3 * SECOND)
    assert not told(nothing, 0.0, nothing, nothing).any()


def test_a_finding_gives_the_faults_another_second():
    constant = np.ones(3 * SECOND)
    says = told(0.0 * constant, 1.0, constant, 0.0 * constant, begins=(SECOND, 2 * SECOND - 1))
    assert not says[SECOND : 3 * SECOND - 1].any()
    assert says[-1]


def test_a_d_hat_that_is_no_number_is_forgotten():
    constant = np.ones(3 * SECOND)
    residuals = np.where(np.arange(3 * SECOND) == 10, math.inf, 0.0)
    says = told(residuals, 1.0, constant, 0.0 * constant)
    assert not says[: 10 + SECOND].any()
    assert says[-1]


def test_a_push_that_ends_leaves_nothing_known():
    """The push of a second and its end look like a bias, a loss, and what cancels both."""
    tick_s, ticks = 0.005, 2000
    target = Target(tick_s, 1, "zoh", noise_rms=0.003, mismatch=other_cars(2), on_confirmation=True)
    table, noise = build(DESIGN, target), 0.003 * np.random.default_rng(1).standard_normal(ticks)
    time_s = tick_s * np.arange(ticks)
    pushed = ((time_s >= 3.0) & (time_s < 4.0)) * 0.15
    slow = signal.sosfilt(signal.butter(2, 3.0, fs=1.0 / tick_s, output="sos"), pushed)
    trace = simulate(table, sample(CAR, tick_s), np.sin(2.0 * time_s), noise=noise, bias=slow)
    over = round(6.0 / tick_s)
    assert trace.verdict[:over].any()
    assert not trace.verdict[over:].any()
    assert not (trace.fault_state[over:] == FaultState.CONFIRMED).any()
