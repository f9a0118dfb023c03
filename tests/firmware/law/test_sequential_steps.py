"""The sequential test tick by tick: sums, restarts, and the values after a restart."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import signal, stats

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.law import controller
from firmware_model.law.fault_decision.likelihood_ratio import (
    advance_candidate,
    candidate_output,
    candidate_shown,
    forget_candidate,
    is_stale,
    lost_share,
    start_candidate,
    update_test,
)
from firmware_model.law.filters.biquad import advance, at_rest
from tests.firmware.law.cases import CAR, DESIGN, TICK_S, changed

pytestmark = pytest.mark.every_case  # a case each of few lines

ABOVE = math.nextafter(1.0, 2.0)
NUMBERS = {"restart": -1.0, "freshness": 0.1, "needed": 24.0, "promising": 8.0, "deviations": 3.0}


def begun(latency: int = 1, **numbers: float) -> tuple[Any, Any]:
    table = build(DESIGN, Target(TICK_S, latency, "zoh"))
    table = changed(table, sequential_test=NUMBERS | numbers)[0]
    state = controller.init(table)[0]
    state.mismatch.variance = 1.0
    return table, state


@pytest.mark.parametrize("share", [0.5, -0.8])
def test_the_evidence_is_how_much_likelier_the_innovations_are_with_a_loss(share: float) -> None:
    """w is whitened, and less what a filter of two states would have made of it."""
    table, state = begun(restart=-math.inf, freshness=0.0)
    table.mismatch.n, table.mismatch.whitener.n = 2, 1
    table.mismatch.whitener.coefficients[0] = 1.0, 0.4, 0.0, 1.0, 0.0  # 1 - 0.6/z
    draw = np.random.default_rng(5)
    w, sigma = draw.standard_normal(12), draw.uniform(0.5, 2.0, 12)
    x, gain, memory = draw.uniform(-0.4, 0.4, (3, 12, 2))
    new = share * w + sigma * draw.standard_normal(12)
    explained, f = np.zeros(2), np.zeros(12)
    for k in range(12):
        f[k] = w[k] - 0.6 * (w[k - 1] if k else 0.0) - x[k] @ explained
        explained = memory[k] * (explained + gain[k] * f[k])
        filtered = state.mismatch
        filtered.variance = sigma[k] ** 2
        filtered.regressor[:2], filtered.gain[:2], filtered.memory[:2] = x[k], gain[k], memory[k]
        state.sequential_test.delay[state.estimator.shown_index_1] = w[k]
        update_test(table, state, float(new[k]), share)
    test = state.sequential_test
    likelier = stats.norm.logpdf(new, share * f, sigma) - stats.norm.logpdf(new, 0.0, sigma)
    assert test.evidence == pytest.approx(likelier.sum(), rel=1e-9)
    assert test.correlation == pytest.approx((f * new / sigma**2).sum(), rel=1e-9)
    assert test.information == pytest.approx((f**2 / sigma**2).sum(), rel=1e-9)
    assert test.age == 12.0
    np.testing.assert_allclose(test.explained[:2], explained)


@pytest.mark.parametrize(
    ("age", "half_age", "information", "half_information", "stale"),
    [
        (3.0, 0.0, 10.0, 10.0, False),  # too young to ask
        (9.0, 5.0, 10.0, 10.0, False),
        (4.0, 1.0, 10.9, 10.0, True),
        (10.0, 5.0, 11.0, 10.0, False),
        (10.0, 5.0, 1023.9, 1000.0, True),  # enough to decide, at any amount of information
        (10.0, 5.0, 1024.0, 1000.0, False),
    ],
)
def test_a_candidate_twice_as_old_that_has_learnt_little_is_stale(
    age: float, half_age: float, information: float, half_information: float, stale: bool
) -> None:
    table, state = begun()
    test = state.sequential_test
    test.age, test.half_age = age, half_age
    test.information, test.half_information = information, half_information
    assert is_stale(table.sequential_test, test) == stale
    asked = age >= 2.0 * max(half_age, 2.0)
    assert test.half_age == (age if asked else half_age)
    assert test.half_information == (information if asked else half_information)


@pytest.mark.parametrize(
    ("evidence", "share", "age", "begins"),
    [
        (-1.0, 0.5, 1.0, True),
        (-1.0 / ABOVE, 0.5, 1.0, False),
        (0.0, 0.5, 7.0, True),  # stale
        (8.0, 0.5, 7.0, True),
        (8.0 * ABOVE, 0.5, 7.0, False),  # a suspicion that is acted upon
        (8.0 * ABOVE, -0.5, 7.0, True),  # there is none of a return
    ],
)
def test_a_candidate_begins_again_where_the_evidence_is_against_it_or_no_more_comes(
    evidence: float, share: float, age: float, begins: bool
) -> None:
    table, state = begun()
    test = state.sequential_test
    test.age, test.half_age, test.evidence = age, 4.0, evidence
    test.information = test.half_information = 10.0
    update_test(table, state, 0.0, share)
    assert test.age == (0.0 if begins else age + 1.0)


@pytest.mark.parametrize("latency", [0, 1, 3])
def test_a_candidate_begins_with_the_commands_that_are_on_their_way(latency: int) -> None:
    """W of those alone, by scipy; the one that has acted just now is that before the loss."""
    table, state = begun(latency)
    test, sent = state.sequential_test, [30.0, -20.0, 50.0][:latency]
    for name in test.dtype.names:
        test[name] = 7.0
    for name in ("channel_1", "earlier"):
        test[name].accumulators[:] = 7.0
    state.command_1 = 11.0
    for i, command in enumerate(sent):
        state.estimator.delay_1[i] = command
    start_candidate(table, state)
    w = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, [*sent, 0.0])
    np.testing.assert_allclose(test.delay[:latency], w[:latency], atol=1e-15)
    assert test.previous_output == pytest.approx(w[latency - 1] if latency else 0.0)
    assert candidate_output(table, state) == pytest.approx(w[latency])  # no feedthrough
    before = at_rest()
    advance(table.estimator.channel_1, before, sent[0] if sent else 11.0)
    np.testing.assert_array_equal(test.earlier.accumulators, before.accumulators)
    others = ("evidence", "correlation", "information", "age", "half_age")
    assert [test[name] for name in (*others, "half_information")] == [0.0] * 6
    assert not test.white.memory.any()
    assert not test.explained.any()


@pytest.mark.parametrize("latency", [0, 1])
def test_w_goes_on_with_each_command_and_is_shown_when_it_gets_there(latency: int) -> None:
    table, state = begun(latency)
    test, commands = state.sequential_test, [30.0, -20.0, 50.0, 10.0]
    test.earlier.accumulators[0, 0] = 1.0
    before = at_rest()
    before.accumulators[0, 0] = 1.0
    w = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, commands)
    for k, command in enumerate(commands):
        state.command_1 = command
        shown = w[k] if latency == 0 else w[k - 1] if k else 0.0
        assert candidate_shown(table, state) == pytest.approx(shown, abs=1e-15)
        advance_candidate(table, state)
        assert test.previous_output == pytest.approx(w[k], abs=1e-15)
        advance(table.estimator.channel_1, before, 0.0)
        np.testing.assert_array_equal(test.earlier.accumulators, before.accumulators)


@pytest.mark.parametrize(
    ("correlation", "information", "share"),
    [
        (5.0, 0.0, 1.0),  # nothing is known of it
        (3.0, math.nan, 1.0),
        (-2.0, 4.0, 0.0),
        (2.4, 4.0, 0.6),
        (5.2, 4.0, 1.0),  # 1.3, but 1 is within three deviations
        (1.3e6, 1e6, 1.297),  # and here it is not
    ],
)
def test_the_share_is_a_regression_s_and_above_one_only_as_far_as_it_must_be(
    correlation: float, information: float, share: float
) -> None:
    table, state = begun()
    test = state.sequential_test
    test.correlation, test.information = correlation, information
    assert lost_share(table.sequential_test, test) == pytest.approx(share, abs=1e-12)


def test_what_was_learnt_of_another_car_from_a_loss_is_taken_back() -> None:
    table, state = begun()
    table.mismatch.n = 3
    state.mismatch.theta[:3], state.sequential_test.explained[:3] = (1.0, 2.0, 3.0), (0.5, 1.0, 0.0)
    forget_candidate(table, state, 0.8)
    np.testing.assert_allclose(state.mismatch.theta[:3], [0.6, 1.2, 3.0])
