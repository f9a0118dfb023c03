"""What a report says of a table, computed another way."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import integrate, special, stats

from can_rig.campaigns.statistics import (
    explained,
    numbers,
    parts_of,
    percent,
    poisson_interval,
    rate,
    spread,
    worst,
)


@given(passed=st.integers(0, 300), failed=st.integers(0, 300), unknown=st.integers(0, 5))
def test_a_rate_has_the_exact_interval(passed, failed, unknown):
    found = rate("some", "text", [True] * passed + [False] * failed + [None] * unknown)
    assert (found.passed, found.failed, found.unknown) == (passed, failed, unknown)
    n = passed + failed
    if n == 0:
        assert found.share is found.low is found.high is None
        return
    low = 0.0 if passed == 0 else special.betaincinv(passed, n - passed + 1, 0.025)
    high = 1.0 if passed == n else special.betaincinv(passed + 1, n - passed, 0.975)
    assert (found.low, found.high) == pytest.approx((low, high), abs=1e-9)


def test_a_failure_among_a_million_runs_is_no_100_percent():
    shares = [None, 0.0, 1e-6, 0.5, 2.0 / 3.0, 1.0 - 1e-6, 1.0]
    said = ["-", "0.00%", "0.000100%", "50.00%", "66.67%", "99.999900%", "100.00%"]
    assert [percent(share) for share in shares] == said


@pytest.mark.parametrize("events", [0, 1, 7, 40])
def test_a_count_has_the_exact_interval(events):
    low, high = poisson_interval(events)
    assert stats.poisson.cdf(events, high) == pytest.approx(0.025)
    assert low == 0.0 if events == 0 else stats.poisson.sf(events - 1, low) == pytest.approx(0.025)


def test_an_axis_explains_what_it_does_and_chance_nothing():
    draw = np.random.default_rng(1)
    x, noise = draw.uniform(0.0, 1.0, (2, 20_000))
    assert explained(x.tolist(), noise) == pytest.approx(0.0, abs=2e-3)
    assert explained(x.tolist(), x) == pytest.approx(1.0 - 1.0 / 64.0, abs=2e-3)  # eight parts
    # Of x² + noise/3 the share of x is Var(x²) / (Var(x²) + Var(noise)/9), both by integration.
    square = integrate.quad(lambda t: (t**2 - 1.0 / 3.0) ** 2, 0.0, 1.0)[0]
    share = square / (square + 1.0 / 108.0)
    assert explained(x.tolist(), x**2 + noise / 3.0) == pytest.approx(share, abs=0.02)


def test_an_axis_of_words_and_one_that_does_not_vary():
    metric = np.array([1.0, 1.0, 5.0, 5.0, 1.0, 5.0])
    assert explained(["a", "a", "b", "b", "a", "b"], metric) == pytest.approx(1.0)
    assert explained([True, True, False, False, True, False], metric) == pytest.approx(1.0)
    assert explained(["a"] * 6, metric) is None
    assert explained([1, 2, 3, 4, 5, 6], np.full(6, 2.0)) is None
    assert explained([1, 2], np.array([np.nan, 1.0])) is None


def test_many_values_are_cut_into_equal_parts_and_few_are_their_own():
    parts = parts_of(np.random.default_rng(2).random(800).tolist())
    assert np.bincount(parts).tolist() == [100] * 8
    assert parts_of([3.0, 1.0, 3.0, 2.0]).tolist() == [2, 0, 2, 1]


def test_a_spread_leaves_out_what_is_not_there():
    found = spread("some", [None, 3.0, 1.0, 2.0, None])
    assert found is not None
    assert (found.runs, found.least, found.median, found.greatest) == (3, 1.0, 2.0, 3.0)
    assert spread("some", [None, None]) is None
    np.testing.assert_array_equal(numbers([True, None, 2]), [1.0, np.nan, 2.0])


def test_the_worst_run_comes_first_and_one_without_a_margin_not_at_all():
    columns = {"run": [0, 1, 2, 3], "margin": [0.5, None, -2.0, 0.5], "x": [1, 2, 3, 4],
               "command": list("abcd")}  # fmt: skip
    assert [row["run"] for row in worst(columns, {"x": columns["x"]})] == [2, 0, 3]
