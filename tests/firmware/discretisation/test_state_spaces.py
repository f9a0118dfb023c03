"""State spaces in factored form: their zeros, and the gain between zeros and poles."""

import cmath

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import linalg, signal

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.systems import StateSpace

S = 1j * np.geomspace(0.01, 1e4, 30)
stable = st.floats(-50.0, -0.5)


def turned(system: StateSpace, seed: int) -> StateSpace:
    """The same system in other coordinates."""
    a, b, c = system.a, system.b, system.c
    rotation = np.linalg.qr(np.random.default_rng(seed).standard_normal(a.shape))[0]
    return StateSpace(rotation @ a @ rotation.T, rotation @ b, c @ rotation.T, system.d)


@given(
    poles=st.lists(stable, min_size=1, max_size=5, unique=True),
    zeros=st.lists(stable, max_size=5),
    turn=st.integers(0, 2**32 - 1),
)
def test_a_state_space_keeps_its_zeros_in_any_coordinates(poles, zeros, turn):
    zeros = zeros[: len(poles)]
    g = ZeroPoleGain(tuple(map(complex, zeros)), tuple(map(complex, poles)), 2.0)
    a, b, c, d = signal.zpk2ss(g.zeros, g.poles, g.gain)
    # Rotated as it is, with numbers from 1 to 1e7 side by side, its rounding has other zeros.
    a, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
    b, c = b / scale[:, None], c * scale
    system = StateSpace(a, b, c, d.item())
    assert len(system.zero_pole_gain().zeros) == len(zeros)
    inside = S[np.abs(S) < 100.0]
    error = np.abs(turned(system, turn).zero_pole_gain()(inside) - g(inside))
    assert np.all(error <= 1e-3 * np.abs(g(inside)).max())


def test_a_state_space_without_states_or_without_a_way_through_is_a_constant():
    empty = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
    assert StateSpace(*empty, 2.5).zero_pole_gain() == ZeroPoleGain.constant(2.5)
    assert StateSpace(*empty, 2.5)(S) == pytest.approx(2.5)
    a, c = np.diag([-1.0, -2.0, -3.0]), np.array([[0.0, 0.0, 1.0]])
    hidden = StateSpace(a, np.array([[1.0], [2.0], [0.0]]), c, 0.0)
    for system in (hidden, turned(hidden, 0)):  # turned, its response is rounding, not zero
        assert system.zero_pole_gain() == ZeroPoleGain.constant(0.0)
    assert turned(hidden, 0)(np.array([1.0 + 1j])) != 0.0


def test_a_zero_of_high_order_keeps_its_digits():
    """Eigenvalues lose the digits of all zeros together, and the response keeps its digits."""
    g = ZeroPoleGain((-1.0,) * 5, (-2.0,) * 6, 2.0)
    a, b, c, d = signal.zpk2ss(g.zeros, g.poles, g.gain)
    found = StateSpace(a, b, c, d.item()).zero_pole_gain()
    np.testing.assert_allclose(found(S), g(S), rtol=1e-12)


def test_zeros_far_apart_keep_their_digits():
    """In parallel form, by residues, where eigenvalues alone are wrong by 1e-4."""
    zeros = np.array([-1e-4, -2e-3, -3e-3, -70.0, -8e3, -9e4])
    poles = np.array([-1e-3, -0.02, -0.1, -3.0, -400.0, -2e4, -2e5])
    residues = [2.0 * np.prod(p - zeros) / np.prod(p - poles[poles != p]) for p in poles]
    system = StateSpace(np.diag(poles), np.ones((7, 1)), np.array([residues]), 0.0)
    np.testing.assert_allclose(np.sort(system.zero_pole_gain().zeros), np.sort(zeros), rtol=1e-11)


@pytest.mark.parametrize(
    ("a", "b", "c", "num", "den"),
    [
        ([[0, 1], [0, 0]], [0, 1], [3, 0], [3], [1, 0, 0]),  # poles at the origin alone
        ([[0, 1], [0, -2]], [0, 1], [3, 1], [1, 3], [1, 2, 0]),  # and with another
        ([[3]], [2], [1], [2], [1, -3]),
        ([[0, 1], [-2, 2]], [0, 1], [1, 0], [1], [1, -2, 2]),  # at 45°
        ([[0, 1], [-4, 0]], [0, 1], [1, 0], [1], [1, 0, 4]),  # on the axis
        ([[-1]], [1], [-3], [-3], [1, 1]),  # its first answer is negative
        ([[-1]], [1e-20], [3e20], [3], [1, 1]),
        ([[-1]], [1e20], [3e-20], [3], [1, 1]),
        # a chain: balancing by permutation would turn it round
        (
            [[-1, 0, 0], [3, -2, 0], [5, 1e3, -40]], [7, 0, 0], [0, 1, 2],
            [91, 42980], [1, 43, 122, 80],
        ),
    ],
)  # fmt: skip
def test_a_state_space_is_the_fraction_worked_out_by_hand(a, b, c, num, den):
    system = StateSpace(np.array(a, float), np.array([b], float).T, np.array([c], float), 0.0)
    g = system.zero_pole_gain()
    assert (len(g.zeros), len(g.poles)) == (len(num) - 1, len(den) - 1)
    np.testing.assert_allclose(g.numerator(), num, rtol=1e-9)
    np.testing.assert_allclose(g.denominator(), den, rtol=1e-9, atol=1e-9)


def test_the_distance_of_two_systems_is_that_of_their_responses():
    """1/(s (s + ½)) in states; points lie a radian from the real axis, at |s| = ½."""
    system = StateSpace(
        np.array([[0.0, 1.0], [0.0, -0.5]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), 0.0
    )
    same = ZeroPoleGain((), (0.0, -0.5), 1.0)
    assert system.distance(same) == pytest.approx(0.0, abs=1e-15)
    assert system.distance(same.scaled(0.5)) == pytest.approx(0.5)
    assert system.distance(same.scaled(2.5)) == pytest.approx(1.5)
    moved = ZeroPoleGain((), (0.0, -0.25), 1.0)
    s = 0.25 * cmath.rect(1.0, 1.0)
    assert system.distance(moved) == pytest.approx(abs((s + 0.5) / (s + 0.25) - 1.0))
