"""Bounds of rounding, by their definitions written out and by runs of scipy."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation import rounding
from firmware_model.discretisation.rounding import (
    ROUNDING,
    of_held,
    of_sections,
    of_system,
    run_error,
)
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.systems import Polynomials, StateSpace

TICK_S = 1e-3
POINTS = np.array([0.3j, 2.0j - 0.1, 0.7 + 0.2j])


def cancelled(*terms: complex) -> float:
    """Σ|terms|/|sum|."""
    return sum(map(abs, terms)) / abs(sum(terms))


def test_of_sections_each_polynomial_counts():
    rows = [[2.0, -3.0, 0.5, 1.5, -0.7], [0.0, 1.0, 0.0, 0.4, 0.0], [0.0, 0.0, 0.0, 0.1, 0.2]]
    x = 0.3 - 0.2j
    by_hand = (
        cancelled(2.0 * x * x, -3.0 * x, 0.5) + cancelled(x * x, 1.5 * x, -0.7)
        + cancelled(1.0) + cancelled(x, 0.4)
        + 1.0 + cancelled(x * x, 0.1 * x, 0.2)
    )  # fmt: skip
    found = of_sections(Sections(np.array(rows), TICK_S), np.array([x, x]))
    np.testing.assert_allclose(found, by_hand, rtol=1e-14)


def test_at_zero_what_a_section_of_first_order_has_twice_does_not_count():
    """δ/δ has no value at zero, and stays out of the sum."""
    found = of_sections(Sections(np.array([[1.0, 2.0, 0.0, 3.0, 0.0]]), TICK_S), np.zeros(1) + 0j)
    assert found.tolist() == [2.0]


def test_of_zeros_and_poles_each_distance_counts():
    zeros, poles = (-1.0 + 2.0j, -1.0 - 2.0j), (-3.0, -0.1, 0.5)
    found = of_system(ZeroPoleGain(zeros, poles, 7.0), POINTS)
    for s, value in zip(POINTS, found, strict=True):
        roots = [*zeros, *poles]
        assert value == pytest.approx(1.0 + sum((abs(s) + abs(r)) / abs(s - r) for r in roots))
    assert of_system(ZeroPoleGain.constant(2.0), POINTS).tolist() == [1.0] * 3


def test_of_polynomials_every_coefficient_is_rounded():
    found = of_system(Polynomials(np.array([2.0, -1.0]), np.array([1.0, 0.5, 3.0])), POINTS)
    expected = [5 * (cancelled(2.0 * s, -1.0) + cancelled(s * s, 0.5 * s, 3.0)) for s in POINTS]
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_of_one_state_by_hand():
    """The worst of the points, at each of them."""
    a, b, c, d = -2.0, 2.0, 2.0, 5.0  # balanced already
    found = of_system(StateSpace(np.array([[a]]), np.array([[b]]), np.array([[c]]), d), POINTS)
    each = []
    for s in POINTS:
        r = 1.0 / abs(s - a)
        x, y = r * abs(b), r * abs(c)
        response = (abs(a) * x * y + abs(b) * y + abs(c) * x + abs(d)) / abs(c * b / (s - a) + d)
        each.append(abs(a) * r + response)
    np.testing.assert_allclose(found, max(each), rtol=1e-13)
    assert np.ptp(each) > 0.1


def norms(system: StateSpace, s: complex) -> float:
    """‖a‖‖R‖ and the response's, with Frobenius' norms, for n states."""
    n = len(system.a)
    r = np.linalg.inv(s * np.eye(n) - system.a)
    x, y = r @ system.b, system.c @ r
    of = np.linalg.norm
    bound = of(system.a) * of(x) * of(y) + of(system.b) * of(y) + of(system.c) * of(x)
    answer = abs((system.c @ x).item() + system.d)
    return float(n * (of(system.a) * of(r) + (bound + abs(system.d)) / answer))


def test_of_states_in_whichever_units():
    """Rows and columns of one size: balanced already; in other units they are so almost again."""
    a = np.array([[-1.0, 1.0, 0.0], [1.0, -3.0, 1.0], [0.0, 1.0, -2.0]])
    b, c = np.array([[1.0], [0.5], [0.0]]), np.array([[0.0, 1.0, 2.0]])
    system = StateSpace(a, b, c, -0.25)
    found = of_system(system, POINTS)
    np.testing.assert_allclose(found, max(norms(system, s) for s in POINTS), rtol=1e-12)
    units = np.array([1.0, 1024.0, 2.0**-8])
    scaled = StateSpace(a * units[:, None] / units, b * units[:, None], c / units, -0.25)
    assert found[0] / 8.0 < of_system(scaled, POINTS)[0] < 8.0 * found[0]
    assert max(norms(scaled, s) for s in POINTS) > 1e4 * found[0]


@pytest.mark.parametrize("a", [[[-1.0, 0.0], [1.0, -3.0]], [[-1.0, 1.0], [0.0, -3.0]]])
def test_states_stay_in_their_order(a):
    """Of a triangular matrix too, which balancing would reorder."""
    system = StateSpace(np.array(a), np.array([[1.0], [0.5]]), np.array([[0.3, 2.0]]), 0.0)
    expected = max(norms(system, s) for s in POINTS)
    np.testing.assert_allclose(of_system(system, POINTS), expected, rtol=1e-12)


def test_of_no_states_and_of_a_sum_without_digits():
    nothing = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 2.0)
    assert of_system(nothing, POINTS).tolist() == [1.0, 1.0, 1.0]
    lost = StateSpace(np.array([[-1.0]]), np.array([[1.0]]), np.array([[1.0]]), -1.0)
    assert of_system(lost, np.zeros(1) + 0j).tolist() == [np.inf]


def motion(row: NDArray[Any], u: NDArray[Any], s1: float = 0.0, s2: float = 0.0) -> NDArray[Any]:
    """y, and s1 and s2 after each tick, of one section in δ."""
    b0, b1, b2, a1, a2 = row
    rows = []
    for value in u:
        y = b0 * value + s1
        s1, s2 = s1 + b1 * value - a1 * y + s2, s2 + b2 * value - a2 * y
        rows.append((y, s1, s2))
    return np.array(rows).T


def through(rows: NDArray[Any], u: NDArray[Any]) -> NDArray[Any]:
    """The output of a cascade, by scipy."""
    if not len(rows):
        return u
    return np.asarray(signal.sosfilt(Sections(np.array(rows), TICK_S).sos, u))


@pytest.mark.parametrize("ticks", [1, 40])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_run_is_off_by_what_each_operation_rounds(ticks, precision):
    """Three sections; signals and what becomes of errors are sums over impulse responses."""
    sections = np.array([
        [0.9, 0.2, 0.05, 0.5, 0.1], [0.0, 0.3, 0.0, 0.4, 0.0], [0.5, -0.6, 0.1, 0.9, 0.3],
    ])  # fmt: skip
    impulse = np.zeros(ticks)
    impulse[0] = 1.0
    u, error = 1.0, 0.0
    for i, row in enumerate(sections):
        b0, b1, b2, a1, a2 = np.abs(row)
        y, s1, s2 = np.abs(motion(row, through(sections[:i], impulse))).sum(axis=1)
        after = sections[i + 1 :]
        to_output = [
            np.abs(through(after, motion(row, 0.0 * impulse, *start)[0])).sum()
            for start in ((1.0, 0.0), (0.0, 1.0))
        ]
        onwards = np.abs(through(after, impulse)).sum()
        at_y = 2.0 * b0 * u + y  # a product, rounded with its coefficient, and a sum
        at_1 = 4.0 * (b1 * u + a1 * y) + 2.0 * s2 + s1  # two products in three sums
        at_2 = 3.0 * (b2 * u + a2 * y) + s2
        error += at_y * (onwards + a1 * to_output[0] + a2 * to_output[1])
        error += at_1 * to_output[0] + at_2 * to_output[1]
        u = y
    found = run_error(Sections(sections, TICK_S), ticks, precision)
    assert found == pytest.approx(ROUNDING[precision] * error, rel=1e-12)


def test_a_rounding_is_half_of_the_last_digit():
    for precision in ("float64", "float32"):
        assert ROUNDING[precision] == np.finfo(precision).eps / 2
    made = Sections(np.array([[1.0, 0.0, 0.0, 0.5, 0.0]]), TICK_S)
    assert run_error(made, 5) == run_error(made, 5, "float32")


def test_a_gain_is_rounded_once():
    found = of_held(ZeroPoleGain((), (), -3.0), TICK_S, np.array([1j, 2.0 + 0j]))
    np.testing.assert_array_equal(found, [3.0, 3.0])


def test_a_zero_found_on_a_pole_has_no_bound(monkeypatch):
    """The exact place of a zero is a matter of the host's linear algebra."""
    monkeypatch.setattr(rounding, "zeros_of", lambda system, through, poles: poles)
    g = ZeroPoleGain((-3.0,), (-1.0,), 1.0)
    assert np.isinf(of_held(g, 1.0, np.array([0.5 + 0j]))).all()
