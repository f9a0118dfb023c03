"""Zeros refined on the response, and zeros without a refinement."""

import numpy as np
import pytest

from firmware_model.discretisation import held_input
from firmware_model.discretisation.held_input import refined

A, B = np.array([[-1.0, 0.0], [0.0, -3.0]]), np.ones((2, 1))
POLES = np.array([-1.0, -3.0], np.complex128)


def test_a_rough_zero_becomes_exact():
    """1/(x + 1) + 1/(x + 3) is zero at -2."""
    (zero,) = refined(A, B, np.ones((1, 2)), POLES, [-2.2])
    assert zero == pytest.approx(-2.0, abs=1e-15)


def test_a_zero_that_cancels_a_pole_stays_as_it_was_found():
    """The resolvent does not exist at the zero: 1/(x + 3) with a hidden pole at -1."""
    assert refined(A, B, np.array([[0.0, 1.0]]), POLES, [-1.0]) == [-1.0]


PLACES = np.array([-1.0, -3.0, -0.2, -9.0, -0.05, -5.0, -0.6], np.complex128)  # of the poles
ZEROS = [-2.0, -0.7, -0.1 + 0.6j, -0.1 - 0.6j, -1.3 + 0.37j, -1.3 - 0.37j]


def parallel() -> tuple[np.ndarray, ...]:
    """Π(x - zero)/Π(x - pole) as a sum of first-order parts."""
    residues = [
        np.prod([pole - zero for zero in ZEROS])
        / np.prod([pole - other for other in PLACES if other != pole])
        for pole in PLACES
    ]
    n = len(PLACES)
    return np.diag(PLACES.real), np.ones((n, 1)), np.real(residues)[None, :]


def rough(error: float) -> list[complex]:
    return [(1.0 + error) * zero + 0.1 * error * zero.imag for zero in map(complex, ZEROS)]


def test_real_zeros_and_pairs_are_refined_at_once():
    found = refined(*parallel(), PLACES, iter(rough(0.02)))
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(ZEROS), rtol=1e-13)
    assert [zero.imag for zero in found[:2]] == [0.0, 0.0]
    assert found[4:] == [zero.conjugate() for zero in found[2:4]]


def test_pairs_stay_conjugate_to_the_bit(monkeypatch):
    """Also on their way, where the others are summed in another order for each of a pair."""
    monkeypatch.setattr(held_input, "REFINEMENTS", 1)
    for error in np.linspace(0.001, 0.1, 50):
        found = refined(*parallel(), PLACES, rough(error))
        assert found[4:] == [zero.conjugate() for zero in found[2:4]]


def test_a_step_triples_the_digits(monkeypatch):
    """Newton's alone, without the other zeros and the poles, would double them."""
    monkeypatch.setattr(held_input, "REFINEMENTS", 1)
    found = refined(*parallel(), PLACES, rough(1e-4))
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(ZEROS), rtol=1e-10)


def test_what_is_exact_stays_and_so_does_what_is_double():
    """Two equal estimates of a zero give a step of nan, and the zero stays."""
    found = refined(A, B, np.ones((1, 2)), POLES, [-2.0, -2.0])
    assert found == [-2.0, -2.0]


def test_no_zeros_are_none():
    assert refined(A, B, np.ones((1, 2)), POLES, []) == []
