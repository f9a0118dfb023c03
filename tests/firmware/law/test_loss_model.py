"""The known loss s w: its inputs, the part of a candidate, and the estimate of s."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import tustin
from firmware_model.law import controller
from firmware_model.law.core.biquad import output
from firmware_model.law.core.estimator import advance_model
from firmware_model.law.status import FaultState
from firmware_model.law.supervision.decision import restart_test
from firmware_model.law.supervision.likelihood_ratio import advance_candidate, candidate_shown
from firmware_model.law.supervision.loss_model import (
    advance_loss_model,
    clear_loss_model,
    earlier_missing,
    earlier_shown,
    fading_output,
    follow_share,
    known_share,
    loss_output,
    loss_shown,
    lost_command,
    take_over_candidate,
)
from firmware_model.law.supervision.whitener import whiten
from tests.firmware.law.cases import CAR, DESIGN, TICK_S, late

COMMANDS = np.cumsum(np.random.default_rng(1).standard_normal(30))
LATENCIES = [0, 1, 3]


def begun(latency: int) -> tuple[Any, Any]:
    """A channel 1 that is lost; by Tustin's rule w has a feedthrough."""
    table = build(DESIGN, Target(TICK_S, latency))
    state = controller.init(table)[0]
    state.fault_state = FaultState.CONFIRMED
    return table, state


def advance(table: Any, state: Any, command: float) -> None:
    own = state.supervision
    state.command_1 = command
    advance_loss_model(
        table, own.loss_model, state.estimator, lost_command(state.fault_state, state.command_1)
    )
    advance_candidate(table, own.sequential_test, state.estimator, state.command_1)
    advance_model(table.estimator, state.estimator, command, 0.0)


def w_now(table: Any, state: Any) -> float:
    lost = lost_command(state.fault_state, state.command_1)
    return loss_output(table, state.supervision.loss_model, lost)


def w_shown(table: Any, state: Any) -> float:
    lost = lost_command(state.fault_state, state.command_1)
    return loss_shown(table, state.supervision.loss_model, state.estimator, lost)


def candidate_now(table: Any, state: Any) -> float:
    own = state.supervision.sequential_test.channel_1
    return output(table.estimator.channel_1, own, state.command_1)


def candidate_shown_in(table: Any, state: Any) -> float:
    return candidate_shown(
        table, state.supervision.sequential_test, state.estimator, state.command_1
    )


def fading_now(table: Any, state: Any) -> float:
    return fading_output(table, state.supervision.loss_model)


def fading_shown(table: Any, state: Any) -> float:
    own = state.supervision
    return earlier_missing(table, own.loss_model, state.estimator, own.echoes)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_behind_the_whitener_s_w_is_continuous_too(sign):
    """The innovation subtracts s W w: after the take-over the sum of both that were known."""
    table = build(DESIGN, Target(TICK_S, noise_rms=0.01, noise_pole=0.6, disturbance=0.2))
    state = controller.init(table)[0]
    own = state.supervision
    w, candidate = (own.mismatch.white.lost, own.sequential_test.candidate.white)
    for old, new in np.random.default_rng(2).standard_normal((9, 2)):
        whiten(table.mismatch.whitener, w, old)
        whiten(table.mismatch.whitener, candidate, new)
    own.loss_model.share = 0.5
    apart, share = state.copy(), 0.8
    take_over_candidate(table, own.loss_model, own.mismatch, own.sequential_test, share, sign)
    now, before = own.mismatch.white, apart.supervision.mismatch.white
    signals = (now.fading, now.lost, before.lost, apart.supervision.sequential_test.candidate.white)
    for _ in range(6):  # whatever comes: here, nothing
        fading, lost, old, new = (whiten(table.mismatch.whitener, each, 0.0) for each in signals)
        assert fading + share * lost == pytest.approx(0.5 * old + sign * share * new, abs=1e-12)
        assert abs(fading) > 1e-9
        assert abs(lost) > 1e-9


@pytest.mark.parametrize("latency", LATENCIES)
def test_w_is_the_answer_of_g1_to_the_commands_that_are_lost(latency):
    """Commands of a working channel are not lost: w fades with the motion."""
    table, state = begun(latency)
    rows = []
    for k, command in enumerate(COMMANDS):
        state.fault_state = FaultState.CONFIRMED if k < 20 else FaultState.CLEAR
        state.command_1 = command
        rows.append((w_now(table, state), w_shown(table, state)))
        advance(table, state, command)
        rows[-1] += (float(state.supervision.loss_model.previous_output),)
    w = signal.sosfilt(tustin(CAR.g1, TICK_S).sos, np.where(np.arange(30) < 20, COMMANDS, 0.0))
    now, shown, previous = np.array(rows).T
    assert_allclose(now, w, atol=1e-12)
    assert_allclose(previous, w, atol=1e-12)
    assert_allclose(shown, late(w, latency), atol=1e-12)


@pytest.mark.parametrize("latency", LATENCIES)
@pytest.mark.parametrize("start", [0, 11])
def test_the_candidate_is_driven_by_all_commands_that_had_not_acted(start, latency):
    """The candidate knows w one tick before its start, and the speed of w from there."""
    table, state = begun(latency)
    own = state.supervision
    w = signal.sosfilt(
        tustin(CAR.g1, TICK_S).sos, np.where(np.arange(30) < start - latency, 0.0, COMMANDS)
    )
    for k, command in enumerate(COMMANDS):
        if k == start:
            restart_test(table, state, state.supervision)
            before = w[k - 1] if k > 0 and latency > 0 else 0.0
            assert own.sequential_test.previous_output == pytest.approx(before, abs=1e-12)
        state.command_1 = command
        shown = candidate_shown_in(table, state)
        advance(table, state, command)
        if k >= start:
            assert own.sequential_test.previous_output == pytest.approx(w[k], abs=1e-12)
            assert shown == pytest.approx(late(w, latency)[k], abs=1e-12)


@pytest.mark.parametrize("latency", LATENCIES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("known", "share"), [(0.0, 0.7), (0.5, 0.9), (0.8, 0.8)])
@pytest.mark.parametrize("moment", [0.0, 0.3])
def test_what_is_missing_is_continuous_where_a_candidate_is_taken_over(
    known, share, sign, latency, moment
):
    """The loss of before, with its learnt share and moment, and the candidate's, from then on."""
    table, state = begun(latency)
    own = state.supervision
    for k, command in enumerate(COMMANDS):
        if k == 17:
            restart_test(table, state, state.supervision)
        advance(table, state, command)
    loss, older_loss = (own.loss_model, 2.0 * own.sequential_test.earlier.accumulators)
    loss.earlier.accumulators[:] = older_loss
    loss.share = known - 0.1
    own.mismatch.theta[0] = 0.1 if known else 0.0  # what has been learnt of the share since
    own.mismatch.theta[1] = moment
    if known == 0.0:
        loss.share = 0.0
    apart, together = state.copy(), state
    take_over_candidate(
        table,
        together.supervision.loss_model,
        together.supervision.mismatch,
        together.supervision.sequential_test,
        share,
        sign,
    )
    assert loss.share == loss.between == loss.followed == share
    older = output(table.estimator.channel_1, apart.supervision.loss_model.earlier, 0.0)
    assert loss.previous_fading + share * loss.previous_output == pytest.approx(
        known * apart.supervision.loss_model.previous_output
        + moment * older
        + sign * share * apart.supervision.sequential_test.previous_output
    )
    pairs = [(w_now, candidate_now, fading_now)]
    if latency == 0 or moment == 0.0:  # the ring takes the change by the moment for a constant
        pairs.append((w_shown, candidate_shown_in, fading_shown))
    for _ in range(6):  # whatever is lost from now on: here, nothing
        apart.command_1 = together.command_1 = 0.0
        older = output(table.estimator.channel_1, apart.supervision.loss_model.earlier, 0.0)
        for known_w, its_w, fading in pairs:
            expected = known * known_w(table, apart) + sign * share * its_w(table, apart)
            found = fading(table, together) + share * known_w(table, together)
            assert found == pytest.approx(expected + moment * older, abs=1e-12)
            assert abs(expected) > 1e-6
        older = output(table.estimator.channel_1, apart.supervision.sequential_test.earlier, 0.0)
        assert earlier_shown(table, together.supervision.loss_model) == pytest.approx(
            older, rel=1e-12
        )
        assert abs(older) > 1e-9
        advance(table, apart, 0.0)
        advance(table, together, 0.0)


def test_what_is_cleared_is_nothing():
    _, state = begun(3)
    loss = state.supervision.loss_model
    for name in ("share", "between", "followed", "previous_output", "previous_fading"):
        loss[name] = 1.0
    for ring in (loss.delay, loss.fading_delay):
        ring[:] = 0.5
    for model in (loss.channel_1, loss.earlier, loss.fading):
        model.accumulators[:] = 0.5
    assert 0 not in np.frombuffer(loss.tobytes())
    clear_loss_model(state.supervision.loss_model)
    assert not any(loss.tobytes())


def test_the_share_that_is_compensated_follows_by_two_lags():
    """1 - (1 + t/τ) exp(-t/τ), τ of 10 ms, to first order in the tick."""
    table, state = begun(0)
    state.supervision.loss_model.share = 1.0
    followed = []
    for _ in range(60):
        follow_share(table.loss_model, state.supervision.loss_model, 1.0)
        followed.append(float(state.supervision.loss_model.followed))
    expected = signal.lfilter([0.01], np.poly([0.9, 0.9]), np.ones(60))
    np.testing.assert_allclose(followed, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("share", "off", "known"), [(0.9, 0.4, 1.0), (0.1, -0.4, 0.0), (0.5, 0.1, 0.6)]
)
def test_a_known_share_is_none_to_all(share, off, known):
    _, state = begun(0)
    own = state.supervision
    own.loss_model.share, own.mismatch.theta[0] = share, off
    assert known_share(own.loss_model, own.mismatch) == pytest.approx(known)
