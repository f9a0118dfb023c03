"""e^-x: against mpmath, in both precisions, and where it ends."""

import mpmath
import numpy as np
import pytest

from firmware_model.law.exponential import LARGEST, exp_minus


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_is_within_two_roundings(precision):
    real = np.dtype(precision).type
    rounding = float(np.finfo(precision).eps) / 2.0
    random = np.random.default_rng(1)
    uniform, small = random.uniform(0.0, LARGEST, 500), np.geomspace(1e-12, 79.9, 500)
    for x in map(real, np.concatenate([uniform, small])):
        answer, exact = exp_minus(x), mpmath.exp(-mpmath.mpf(float(x)))
        assert abs(float(answer) - exact) <= 2.0 * rounding * exact * (1.0 + 1e-9), x


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_begins_at_one_and_ends_at_zero(precision):
    real = np.dtype(precision).type
    assert exp_minus(real(0.0)) == 1.0
    for x in (LARGEST, 1e4, np.inf, np.nan):
        assert exp_minus(real(x)) == 0.0
    assert exp_minus(real(79.99)) > 0.0
