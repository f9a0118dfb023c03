"""Share and moment of a loss after its confirmation, and what the loss had taught about the car."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import signal

from firmware_model.analysis.sampled_plant import follow_plant, sample
from firmware_model.analysis.simulation import simulate
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.law import controller
from firmware_model.law.status import FaultState
from firmware_model.law.structs import FloatArray
from firmware_model.law.supervision.decision import confirm_or_believe, recover, restart_test
from firmware_model.law.supervision.likelihood_ratio import (
    advance_candidate,
    candidate_shown,
    forget_candidate,
    update_test,
)
from firmware_model.law.supervision.loss_model import known_share
from firmware_model.law.supervision.mismatch import innovation, predict_mismatch
from firmware_model.law.supervision.other_cars import advance_other_cars, show_other_cars
from tests.firmware.law.cases import CAR, DESIGN, TICK_S, changed, other_cars

PLANT = sample(CAR, TICK_S)
TICKS, START = 200, 60
COMMANDS = 40.0 * np.sin(0.05 * np.arange(TICKS)) + 20.0
MODELLED = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, COMMANDS)
W = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, np.where(np.arange(TICKS) < START, 0.0, COMMANDS))


def learner() -> tuple[Any, Any]:
    """A table for which the candidate never begins again, and a state at rest."""
    of = Target(TICK_S, 0, "zoh", noise_rms=0.01, noise_pole=0.5, mismatch=other_cars(2))
    tables = changed(build(DESIGN, of), sequential_test={"restart": -math.inf})
    return tables[0], controller.init(tables[0])[0]


def learn(table: Any, state: Any, residuals: FloatArray, share: float) -> None:
    """From d̂ less what is known to be lost; the candidate begins at START."""
    own = state.supervision
    for k, residual in enumerate(residuals.tolist()):
        if k == START:
            restart_test(table, state, state.supervision)
        state.command_1 = COMMANDS[k]
        show_other_cars(
            table, own.other_cars, state.estimator.measured, state.command_1, state.command_2
        )
        predict_mismatch(table, own.mismatch, own.other_cars.shown, MODELLED[k], 0.0, 0.0)
        new = innovation(table.mismatch, own.mismatch, residual, 0.0, 0.0, 0.0)
        test, known = own.sequential_test, own.mismatch
        shown = candidate_shown(table, test, state.estimator, state.command_1)
        assert not update_test(table, test, known, shown, new, share)
        advance_candidate(table, own.sequential_test, state.estimator, state.command_1)
        advance_other_cars(table, own.other_cars, state.estimator.measured, state.command_2)


@pytest.mark.compiled
@settings(max_examples=10)
@given(share=st.floats(-1.0, 1.0), seed=st.integers(0, 2**32 - 1))
def test_what_is_forgotten_leaves_what_a_filter_without_the_loss_knows(share, seed):
    healthy = 0.05 * np.random.default_rng(seed).standard_normal(TICKS)
    table, ours = learner()
    _, without = learner()
    table.mismatch.beyond = 0.0  # of second order is what each filter makes of its own cars
    learn(table, ours, healthy + share * W, 0.8)
    learn(table, without, healthy, 0.8)
    taught = ours.supervision.mismatch.theta - without.supervision.mismatch.theta
    if abs(share) > 0.1:
        assert np.abs(taught).max() > 0.1 * abs(share)
    forget_candidate(table, ours.supervision.sequential_test, ours.supervision.mismatch, share)
    np.testing.assert_allclose(
        ours.supervision.mismatch.theta, without.supervision.mismatch.theta, atol=1e-9
    )


@pytest.mark.compiled
@pytest.mark.parametrize("share", [0.4, 1.0])
def test_a_car_that_is_the_model_is_that_again_once_its_loss_is_confirmed(share):
    """With the share that least squares finds; and once more when the channel comes back."""
    table, state = learner()
    learn(table, state, share * W, 0.8)
    assert np.abs(state.supervision.mismatch.theta).max() > 0.1
    confirm_or_believe(table, state, state.supervision)
    assert state.fault_state == FaultState.CONFIRMED
    assert state.supervision.loss_model.share == pytest.approx(share, rel=1e-6)
    np.testing.assert_allclose(state.supervision.mismatch.theta, 0.0, atol=1e-6)

    table, state = learner()
    state.supervision.loss_model.share = share
    state.fault_state = FaultState.CONFIRMED
    learn(table, state, -share * W, -share)
    recover(table, state, state.supervision)
    assert state.fault_state == FaultState.CLEAR
    np.testing.assert_allclose(state.supervision.mismatch.theta, 0.0, atol=1e-6)


@pytest.mark.parametrize("happens", [confirm_or_believe, recover])
@pytest.mark.parametrize(
    ("information", "suspect", "variance"),
    [(1e3, 8.0, 0.04), (2e2, 8.0, 0.045), (1e2, 8.0, 0.09), (20.0, 8.0, 0.09), (0.0, 200.0, 0.045),
     (0.0, 8.0, 0.09)],
)  # fmt: skip
def test_the_doubt_about_a_loss_is_what_the_evidence_leaves_of_it(
    information, suspect, variance, happens
):
    """9 over Σ f²/S, 1 over the variance of the least squares; 0.04 at least, 0.09 at most.

    About the moment it is half of the time that the confirmation took.
    """
    table, _ = learner()
    tables = changed(table, decision={"suspect": suspect})
    state = controller.init(tables[0])[0]
    weighed = state.supervision.sequential_test.candidate
    weighed.information, weighed.age = information, 30.0
    happens(tables[0], state, state.supervision)
    assert state.supervision.mismatch.covariance.variances[1] == pytest.approx(15.0**2)
    assert state.supervision.mismatch.covariance.variances[0] == pytest.approx(variance)


@pytest.mark.compiled
@pytest.mark.parametrize("off", [0.4, -0.4])
@pytest.mark.parametrize("latency", [0, 2])
def test_a_share_that_is_off_at_its_confirmation_is_right_a_second_later(latency, off):
    """A torque channel with half of its effect, taken for 0.1 or 0.9 of it."""
    lost, rms = 300, 0.02
    of = Target(TICK_S, latency, "zoh", noise_rms=rms, on_confirmation=True)
    tables = changed(build(DESIGN, of))
    state, x, y = controller.init(tables[0])[0], PLANT.rest.copy(), 0.0
    own = state.supervision
    noise = rms * np.random.default_rng(6).standard_normal(4000)
    late: list[Any] = [(0.0, 0.0)] * latency
    confirmed, shares = 0, []
    for k in range(4000):
        controller.step(tables[0], state, 1.0, y + noise[k])
        if not confirmed and state.fault_state == FaultState.CONFIRMED:
            confirmed = k
            own.loss_model.share = 0.5 + off
        late.append((float(state.command_1), float(state.command_2)))
        u1, u2 = late.pop(0)
        y = follow_plant(PLANT.phi, PLANT.gamma, PLANT.c, x, (0.5 if k >= lost else 1.0) * u1, u2)
        shares.append(
            (float(known_share(own.loss_model, own.mismatch)), float(own.loss_model.followed))
        )
        if confirmed and k == confirmed + 1000:
            break
    assert lost < confirmed < lost + 300
    assert shares[confirmed][0] == pytest.approx(0.5 + off, abs=0.01)
    assert shares[-1] == pytest.approx((0.5, 0.5), abs=0.05)


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 1])
@pytest.mark.parametrize("rms", [5e-3, 1e-3, 1e-4])
@pytest.mark.parametrize("road", ["bend", "curves", "turns"])
def test_a_trusted_model_keeps_a_confirmed_loss_for_ever(road, rms, latency):
    """20 s in three drives: what was off about the loss's moment stays where the car moves too."""
    ticks, lost = 21_000, 1000
    at_s = TICK_S * np.arange(ticks)
    reference = {
        "bend": np.ones(ticks),
        "curves": np.sin(2.0 * at_s + 0.5),
        "turns": np.where(at_s % 7.0 < 3.0, 1.0, -0.5),
    }[road]
    left = np.ones((ticks, 2))
    left[lost:, 0] = 0.0
    of = Target(TICK_S, latency, "zoh", noise_rms=rms, on_confirmation=True)
    for seed in (8, 9, 10):
        noise = rms * np.random.default_rng(seed).standard_normal(ticks)
        trace = simulate(build(DESIGN, of), PLANT, reference, effectiveness=left, noise=noise)
        first = int(np.argmax(trace.fault_state == FaultState.CONFIRMED))
        assert lost < first < lost + 100
        assert (trace.fault_state[first:] == FaultState.CONFIRMED).all()
        if road == "bend":
            assert np.abs(trace.error[-2000:]).max() < max(1e-3, 2.0 * rms)
