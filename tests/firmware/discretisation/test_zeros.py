"""Zeros that are refined on the response, and those that cannot be."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_model.discretisation.zeros import refined

A, B = np.array([[-1.0, 0.0], [0.0, -3.0]]), np.ones((2, 1))
POLES = np.array([-1.0, -3.0], np.complex128)


def test_a_rough_zero_becomes_exact() -> None:
    """1/(x + 1) + 1/(x + 3) is zero at -2."""
    (zero,) = refined(A, B, np.ones((1, 2)), POLES, [-2.2])
    assert zero == pytest.approx(-2.0, abs=1e-15)


def test_a_zero_that_cancels_a_pole_stays_as_it_was_found() -> None:
    """There the resolvent does not exist: 1/(x + 3) with a pole at -1 that nothing shows."""
    assert refined(A, B, np.array([[0.0, 1.0]]), POLES, [-1.0]) == [-1.0]
