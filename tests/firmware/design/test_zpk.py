"""Factored transfer functions against polynomial and high-precision arithmetic."""

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, strategies as st

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import ParameterError

part = st.floats(0.01, 100.0)


def _pair(re: float, im: float) -> list[complex]:
    return [complex(re, im), complex(re, -im)]


roots = st.builds(
    lambda real, pairs: (
        [complex(-r) for r in real] + [z for p in pairs for z in _pair(-p[0], p[1])]
    ),
    st.lists(part, max_size=3),
    st.lists(st.tuples(part, part), max_size=2),
)
functions = st.builds(
    ZeroPoleGain, roots.map(tuple), roots.map(tuple), st.floats(0.01, 100.0) | st.just(-3.0)
)
points = st.builds(complex, st.floats(0.01, 50), st.floats(-50, 50))


def _mp_value(g: ZeroPoleGain, s: complex) -> complex:
    with mpmath.workdps(40):
        value = mpmath.mpf(g.gain)
        for z in g.zeros:
            value *= mpmath.mpc(s) - mpmath.mpc(z)
        for p in g.poles:
            value /= mpmath.mpc(s) - mpmath.mpc(p)
        return complex(value)


@given(functions, points)
def test_value_is_the_factored_product(g, s):
    assert g(s) == pytest.approx(_mp_value(g, s), rel=1e-13)


@given(functions, points)
def test_coefficients_expand_the_factors(g, s):
    assert g.numerator().dtype == g.denominator().dtype == np.float64
    assert g.numerator().shape == (len(g.zeros) + 1,)
    assert g.denominator()[0] == 1.0
    assert np.polyval(g.numerator(), s) / np.polyval(g.denominator(), s) == pytest.approx(
        g(s), rel=1e-11
    )
    assert g.numerator() == pytest.approx(g.gain * np.poly(g.zeros).real, rel=1e-12)


@pytest.mark.compiled
@given(functions, functions, points)
def test_product_inverse_and_scaling(g, h, s):
    assert (g * h)(s) == pytest.approx(g(s) * h(s), rel=1e-12)
    assert (g * h).order == g.order + h.order
    assert (g * h) == (h * g)
    assert g.inverse()(s) == pytest.approx(1 / g(s), rel=1e-12)
    assert g.inverse().relative_degree == -g.relative_degree
    assert g.scaled(-2.5)(s) == pytest.approx(-2.5 * g(s), rel=1e-12)


@given(functions)
def test_only_asked_for_cancellation_cancels(g):
    product = g * g.inverse()
    assert product.order == g.order + len(g.zeros)
    assert product.cancelled() == ZeroPoleGain.constant(g.gain * (1 / g.gain))


def test_cancellation_takes_pairs_once_and_only_exact_ones():
    near = math.nextafter(-1.0, 0.0)
    g = ZeroPoleGain((-1, -1, -2), (-1, near, -3), 2.0)
    assert g.cancelled() == ZeroPoleGain((-1, -2), (near, -3), 2.0)


@given(functions)
def test_roots_survive_a_round_trip_through_their_order(g):
    assert ZeroPoleGain(g.zeros[::-1], g.poles[::-1], g.gain) == g
    assert hash(ZeroPoleGain(g.zeros[::-1], g.poles[::-1], g.gain)) == hash(g)


def test_canonical_order():
    g = ZeroPoleGain((), (-2 - 1j, -5, -2 + 1j, 3, -3, -2 + 1j, -2 - 1j, complex(-0.0, -0.0)), 1.0)
    assert g.poles == (0j, -3, 3, -5, -2 + 1j, -2 - 1j, -2 + 1j, -2 - 1j)
    assert ZeroPoleGain((2 + 1j, 2 - 1j, -1 - 1j, -1 + 1j), (), 1.0).zeros[0] == -1 + 1j
    assert math.copysign(1, g.poles[0].real) == math.copysign(1, g.poles[0].imag) == 1


def test_value_over_an_array_keeps_its_shape():
    g = ZeroPoleGain((-3,), (-1, -2), 1.0)
    s = 1j * np.arange(6.0).reshape(2, 3)
    assert g(s).shape == (2, 3)
    assert g(s) == pytest.approx((s + 3) / ((s + 1) * (s + 2)), rel=1e-15)
    assert isinstance(g(1j), complex)
    assert g(0j) == 1.5


@pytest.mark.parametrize("order", [1, 2, 5])
@pytest.mark.parametrize("tau_s", [1e-3, 0.7, 20.0])
def test_lag(tau_s, order):
    q = ZeroPoleGain.lag(tau_s, order)
    s = 1j * np.logspace(-2, 4, 20)
    assert q(s) == pytest.approx(1 / (1 + tau_s * s) ** order, rel=1e-13)
    assert q.dc_gain == pytest.approx(1.0, rel=1e-14)
    assert (q.order, q.relative_degree, q.is_stable()) == (order, order, True)


@pytest.mark.parametrize(
    ("tau_s", "order", "named"),
    [(0.0, 1, "tau_s = 0.0"), (-1.0, 1, "tau_s = -1.0"), (math.inf, 1, "tau_s = inf"),
     (math.nan, 1, "tau_s = nan"), (1.0, 0, "order = 0"), (1.0, 1.0, "order = 1.0"),
     (1.0, True, "order = True"), (1e-200, 2, "tau_s = 1e-200"), (1e200, 2, "tau_s = 1e\\+200")],
)  # fmt: skip
def test_lag_refuses(tau_s, order, named):
    with pytest.raises(ParameterError, match=named):
        ZeroPoleGain.lag(tau_s, order)


@pytest.mark.parametrize(
    ("poles", "stable"), [((), True), ((-1e-9,), True), ((0,), False), ((1j, -1j), False)]
)
def test_stability_is_strict(poles, stable):
    assert ZeroPoleGain((), poles, 1.0).is_stable() is stable


@pytest.mark.parametrize(
    ("g", "expected"),
    [(ZeroPoleGain((-3,), (-1, -2), 4.0), 6.0), (ZeroPoleGain((0, -1), (-2,), 4.0), 0.0),
     (ZeroPoleGain((-1,), (0, -2), 4.0), math.inf), (ZeroPoleGain((1,), (0, -2), 4.0), -math.inf),
     (ZeroPoleGain((0, -6), (0, -2), 4.0), 12.0),
     (ZeroPoleGain((-1 + 2j, -1 - 2j), (-2,), 2.0), 5.0), (ZeroPoleGain.constant(0.0), 0.0)],
)  # fmt: skip
def test_dc_gain_is_the_limit(g, expected):
    assert g.dc_gain == expected


@given(roots, roots, points)
def test_from_coefficients(zeros, poles, s):
    num, den = (np.atleast_1d(k * np.poly(r).real) for k, r in ((2.0, zeros), (-4.0, poles)))
    g = ZeroPoleGain.from_coefficients(num, den)
    assert g.gain == -0.5
    assert g(s) == pytest.approx(np.polyval(num, s) / np.polyval(den, s), rel=1e-9)


def test_from_coefficients_strips_leading_zeros_and_keeps_the_origin():
    g = ZeroPoleGain.from_coefficients([0, 0, 2, 0], [0, 1, 3, 0, 0])
    assert g == ZeroPoleGain((0,), (0, 0, -3), 2.0)
    assert ZeroPoleGain.from_coefficients(3, 2) == ZeroPoleGain.constant(1.5)


def test_the_zero_function_has_no_roots_and_no_inverse():
    zero = ZeroPoleGain((-1,), (-2, -3), 0.0)
    assert zero == ZeroPoleGain.constant(0.0) == ZeroPoleGain.from_coefficients([0.0], [1, 2])
    assert zero(1j) == 0
    assert zero.numerator().tolist() == [0.0]
    with pytest.raises(ParameterError, match="gain = 0: the zero function has no inverse"):
        zero.inverse()


@pytest.mark.parametrize(
    ("num", "den", "named"),
    [([1], [0, 0], "den is identically zero"), ([1], [], "den is identically zero"),
     ([math.nan], [1], "num = "), ([1], [math.inf, 1], "den = "), ([[1, 2]], [1], "num = "),
     ([1], [1e-300, 1e300], "den leads with 1e-300")],
)  # fmt: skip
def test_coefficients_refused(num, den, named):
    with pytest.raises(ParameterError, match=named):
        ZeroPoleGain.from_coefficients(num, den)


@pytest.mark.parametrize(
    ("zeros", "poles", "gain", "named"),
    [((), (), math.nan, "gain = nan"), ((), (), math.inf, "gain = inf"),
     ((complex(math.nan, 0),), (), 1.0, "zeros contain"),
     ((), (complex(0, math.inf),), 1.0, "poles contain"),
     ((1 + 1j,), (), 1.0, r"zeros contain \(1\+1j\) without its exact conjugate"),
     ((), (1 - 1j,), 1.0, "without its exact conjugate"),
     ((), (1 + 1j, 1 - 1.0000000000000002j), 1.0, "without its exact conjugate"),
     ((), (1j, -1j, 2 + 2j), 1.0, r"poles contain \(2\+2j\) without"),
     ((), (1j, -1j, 2 - 2j), 1.0, r"poles contain \(2\+2j\) without"),
     ((), (1 + 1j, 1 + 1j, 1 - 1j), 1.0, "without its exact conjugate")],
)  # fmt: skip
def test_construction_refused(zeros, poles, gain, named):
    with pytest.raises(ParameterError, match=named):
        ZeroPoleGain(zeros, poles, gain)
