"""C as Q around the model: its transfer function, and limits that are outside its loop."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import linalg, signal

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import by_rule, tustin, zoh
from firmware_model.firmware import Firmware
from firmware_model.law.structs import FloatArray
from tests.firmware.law.cases import CAR, TICK_S

PLANT = sample(CAR, TICK_S)
TAU_Q_S = 0.02
DESIGN = design(CAR, DesignSpecification(tau_s=0.005, tau_q_s=TAU_Q_S, alpha_q=3))


def impulse_response(of: Target, ticks: int) -> FloatArray:
    """u1 after an impulse of r with D* = 0: C itself, for D* does not answer."""
    firmware = Firmware(build(DESIGN, of))
    reference = np.eye(1, ticks)[0]
    return np.array([firmware.step(r, 0.0).command_1 for r in reference.tolist()])


@pytest.mark.parametrize("rule", ["tustin", "tustin-held", "zoh"])
@pytest.mark.parametrize("latency", [0, 1, 4])
def test_it_is_q_over_one_less_q_times_the_delayed_model(latency, rule):
    """C = Q/(1 - Q G1 z^-n) by impulse responses: c = q + (q * g, n later) * c."""
    ticks, impulse = 60, np.eye(1, 60)[0]
    q = signal.sosfilt(tustin(DESIGN.tracking.filter, TICK_S).sos, impulse)
    g = signal.sosfilt(by_rule(rule, CAR.g1, TICK_S).sos, impulse)
    loop = np.concatenate([np.zeros(latency), np.convolve(q, g)])[:ticks]
    around = linalg.toeplitz(loop, np.zeros(ticks))
    expected = linalg.solve_triangular(np.eye(ticks) - around, q, lower=True)
    ours = impulse_response(Target(TICK_S, latency, rule), ticks)
    np.testing.assert_allclose(ours, expected, atol=1e-9 * np.abs(expected).max())


def limited(asked: FloatArray, limit: float, slew: float, lsb: float) -> FloatArray:
    """Each as near as its predecessor and the limits let it to what is asked and a make-up.

    This command leaves the least missing energy. On the grid, with what that took
    off the command before, as far as the limit lets it.
    """
    commands, before, left = [], 0.0, 0.0
    phi, gamma, c = PLANT.phi, PLANT.gamma[:, 0], PLANT.c
    energy = linalg.solve_discrete_lyapunov(phi.T, np.outer(c, c))
    missing = np.zeros(len(phi))
    for wish in asked:
        best = gamma @ energy @ phi @ missing / (gamma @ energy @ gamma)
        made_up = np.clip(best, -slew, slew)
        possible = np.clip(wish + made_up, max(-limit, before - slew), min(limit, before + slew))
        missing = phi @ missing + gamma * (wish - possible)
        before = float(possible)
        if lsb > 0.0:
            wanted = np.clip(possible + left, -limit, limit)
            before = float(np.round(wanted / lsb) * lsb)
            left = wanted - before
        commands.append(before)
    return np.array(commands)


limits = st.sampled_from([20.0, 60.0, 200.0, math.inf])
rates = st.sampled_from([300.0, 3000.0, math.inf])
grids = st.sampled_from([0.0, 0.01, 0.5])


@pytest.mark.compiled
@settings(max_examples=25)
@given(
    levels=st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=5), latency=st.integers(0, 4),
    limit=limits, rate=rates, lsb=grids,
)  # fmt: skip
def test_on_the_car_that_is_the_model_limits_are_outside_the_loop(
    levels, latency, limit, rate, lsb
):
    """Commands are Q r, made up for what the actuator could not do; D* is G1 of those."""
    of = Target(TICK_S, latency, "zoh", limit_1=limit, rate_1=rate, lsb_1=lsb, on_confirmation=True)
    reference = np.repeat(levels, 120)
    trace = simulate(build(DESIGN, of), PLANT, reference)
    asked = signal.sosfilt(tustin(DESIGN.tracking.filter, TICK_S).sos, reference)
    possible = limited(asked, limit, rate * TICK_S, lsb)
    # A rounding of the asked command can fall on the other side of a step of the grid.
    np.testing.assert_allclose(trace.command_1, possible, atol=1e-6 + 1.01 * lsb)
    late = np.concatenate([np.zeros(latency), trace.command_1])[: len(reference)]
    response = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, late)
    np.testing.assert_allclose(trace.measurement, response, atol=1e-9)
    assert np.abs(trace.fault_estimate).max() < 1e-9
    np.testing.assert_array_equal(trace.command_2, 0.0)


@settings(max_examples=15)
@given(level=st.floats(0.1, 2.0), limit=st.floats(60.0, 400.0), rate=st.floats(500.0, 5000.0),
       latency=st.integers(0, 4))  # fmt: skip
@pytest.mark.compiled
def test_whatever_the_limits_it_comes_to_rest_where_it_can(level, limit, rate, latency):
    of = Target(TICK_S, latency, "zoh", limit_1=limit, rate_1=rate, on_confirmation=True)
    trace = simulate(build(DESIGN, of), PLANT, np.full(8000, level))
    reached = min(level, limit * CAR.g1.dc_gain)
    np.testing.assert_allclose(trace.measurement[-500:], reached, rtol=1e-4)
    assert np.abs(np.diff(trace.command_1[-500:])).max() < 1e-6


@pytest.mark.compiled
@pytest.mark.parametrize("disturbance", [0.2, -0.1])
@pytest.mark.parametrize("latency", [0, 3])
def test_a_constant_disturbance_of_y_leaves_no_error(latency, disturbance):
    """The integrator: Q G1 is 1 at rest. What is measured settles at r, in some of Q's lags."""
    bias = np.where(np.arange(1500) < 500, 0.0, disturbance)
    of = Target(TICK_S, latency, "zoh", on_confirmation=True, noise_rms=10.0)
    trace = simulate(build(DESIGN, of), PLANT, np.ones(1500), bias=bias)
    assert np.abs(trace.measured[-200:] - 1.0).max() < 1e-6
    assert trace.measured[500] == pytest.approx(1.0 + disturbance, abs=1e-3)
    assert np.abs(trace.measured[800:] - 1.0).max() < 1e-4


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize("limit_n", [1500.0, 2500.0])
def test_a_loss_beyond_the_authority_is_followed_again_once_it_can_be(limit_n, latency):
    """1 m/s² takes 3 kN; a quarter of this demand is feasible."""
    of = Target(TICK_S, latency, "zoh", limit_1=400.0, limit_2=limit_n, on_confirmation=True)
    reference = np.where(np.arange(9000) < 4000, 1.0, 0.25)
    left = np.ones((9000, 2))
    left[1000:, 0] = 0.0
    trace = simulate(build(DESIGN, of), PLANT, reference, effectiveness=left)
    assert np.abs(trace.command_2[2000:4000]).min() == pytest.approx(limit_n)
    assert trace.measurement[3999] == pytest.approx(limit_n * CAR.g2.dc_gain, rel=0.05)
    # C has not wound up meanwhile, and does not swing back: D* is never lower than asked by much.
    assert np.abs(trace.error[8000:]).max() < 5e-3
    assert trace.measurement[4000:].min() > 0.0
    assert np.abs(trace.command_1).max() <= 400.0
