"""The search for a crossover frequency: scipy's answer, and an end in every case."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from scipy.optimize import brentq

from firmware_model.analysis.margins import zero


@pytest.mark.parametrize(
    "function",
    [
        lambda x: x * x * x - 0.2,
        lambda x: math.exp(30.0 * x) - 2.0,
        lambda x: math.tanh(1e4 * (x - 0.123)),
        lambda x: 1.0 if x > math.pi / 4.0 else -1.0,
    ],
    ids=["cubic", "steep at one end", "almost a jump", "a jump"],
)
def test_it_finds_what_scipy_finds(function: Callable[[float], float]) -> None:
    found = zero(function, 0.0, 1.0)
    assert found == pytest.approx(brentq(function, 0.0, 1.0, xtol=1e-15), rel=1e-14)


def test_it_ends_where_the_loop_gain_is_not_a_number() -> None:
    assert math.isnan(zero(lambda x: math.nan, 0.0, 1.0))
