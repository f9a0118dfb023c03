"""A lost share that a Kalman filter follows at all times, instead of a decision."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.law import controller
from firmware_model.law.fault_decision.loss_model import known_share, loss_shown
from firmware_model.law.status import FaultState
from tests.firmware.law.cases import CAR, TICK_S, other_cars

DESIGN = design(CAR, DesignSpecification(tau_s=0.005, tau_q_s=0.02))
PLANT = sample(CAR, TICK_S)
NOISE_RMS, DRIFT = 0.01, 2.0


def target(latency: int = 1, **changes: Any) -> Target:
    chosen = {"noise_rms": NOISE_RMS, "share_drift": DRIFT, "on_confirmation": True, **changes}
    return Target(TICK_S, latency, "zoh", **chosen)


@pytest.mark.parametrize("latency", [0, 1, 3])
def test_it_is_the_scalar_kalman_filter_of_the_share(latency: int) -> None:
    """s⁺ = (1 - d²T/2) s + d √T white, d̂ = s G1 u1 + noise; G1 u1 by scipy."""
    table = build(DESIGN, target(latency))
    state, ticks = controller.init(table)[0], 300
    measured = 0.3 * np.sin(0.02 * np.arange(ticks))
    commands, shares = np.zeros((2, ticks)), np.zeros(ticks)
    for k, y in enumerate(measured.tolist()):
        controller.step(table, state, math.sin(0.05 * k), y)
        commands[:, k] = state.command_1, state.command_2
        shares[k] = state.mismatch.theta[0]
    acting = np.concatenate([np.zeros((2, latency)), commands], axis=1)[:, :ticks]
    w, of_2 = (
        signal.sosfilt(zoh(g, TICK_S).sos, u) for g, u in zip((CAR.g1, CAR.g2), acting, strict=True)
    )
    share, variance, drift = 0.0, 0.0, DRIFT**2 * TICK_S
    memory, expected = 1.0 - 0.5 * drift, []
    for x, residual in zip(w, w + of_2 - measured, strict=True):
        gain = variance * x / (x * variance * x + NOISE_RMS**2)
        share = memory * (share + gain * (residual - x * share))
        variance = memory**2 * (1.0 - gain * x) * variance + drift
        expected.append(share)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(shares, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("left", [0.0, 0.7])
def test_a_loss_is_followed_carried_and_given_back(left: float) -> None:
    lost, back, ticks = 1000, 4000, 7000
    effectiveness = np.ones((ticks, 2))
    effectiveness[lost:back, 0] = left
    noise = NOISE_RMS * np.random.default_rng(1).standard_normal(ticks)
    trace = simulate(
        build(DESIGN, target()), PLANT, np.ones(ticks), effectiveness=effectiveness, noise=noise
    )
    carried = trace.command_2 * CAR.g2.dc_gain  # of 1 m/s²
    for at, share in ((lost, 0.0), (back, 1.0 - left), (ticks, 0.0)):
        assert carried[at - 500 : at].mean() == pytest.approx(share, abs=0.05)
    confirmed = trace.fault_state == FaultState.CONFIRMED
    assert confirmed[back - 500 : back].all() == (left < 0.5)
    assert not confirmed[:lost].any()
    assert not confirmed[-500:].any()
    assert np.abs(trace.error[-500:].mean()) < 0.02


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 2])
def test_after_a_reset_a_steady_loop_shows_no_loss(latency: int) -> None:
    """w starts at what the command gives, not at rest."""
    table = build(DESIGN, target(latency, mismatch=other_cars(2)))
    state = controller.init(table)[0]
    controller.reset(table, state, 1.0)
    for _ in range(300):
        controller.step(table, state, 1.0, 1.0)
        assert known_share(state) < 1e-6
        assert loss_shown(table, state) == pytest.approx(1.0, rel=1e-6)
        assert state.command_2 == pytest.approx(0.0, abs=1e-2)
    for _ in range(300):
        controller.step(table, state, 1.0, 0.0)  # y is gone, and so is all that channel 1 adds
    assert known_share(state) == pytest.approx(1.0, abs=0.05)
