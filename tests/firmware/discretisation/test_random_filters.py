"""Any stable filter of order 1 to 12 at any tick, against theory in fifty digits and scipy."""

import math
import warnings

import numpy as np
import pytest
from scipy import signal

from firmware_model import discretise, testing
from firmware_model.discretisation.rounding import ROUNDING, of_sections, of_system
from firmware_model.discretisation.systems import continuous
from tests.firmware.discretisation.random_filters import random_filter, tustin_exactly, zoh_exactly

A_FEW = pytest.param(0, 12, id="a few")
MANY = [pytest.param(seed, 100, id=f"{seed}", marks=pytest.mark.compiled) for seed in range(1, 4)]
SHARES = np.array([1e-5, 1e-3, 0.03, 0.2, 0.6, 0.95])  # of the Nyquist frequency


@pytest.mark.parametrize(("seed", "filters"), [A_FEW, *MANY])
def test_tustin_is_within_its_bound_of_theory(seed, filters):
    """From roots and from coefficients; the bound counts how often each number may be rounded."""
    rng = np.random.default_rng(seed)
    for _ in range(filters):
        g, tick_s = random_filter(rng)
        omega = SHARES * math.pi / tick_s
        angle = omega * tick_s
        for system in (g, (g.numerator(), g.denominator())):
            made = discretise(system, tick_s)
            warped = 2j / tick_s * np.tan(angle / 2.0)
            conditioning = of_system(continuous(system), warped) + of_sections(
                made.sections, np.expm1(1j * angle)
            )
            theory = tustin_exactly(system, omega, tick_s)
            error = np.abs(made.frequency_response(omega) / theory - 1.0)
            bound = testing.ROUNDINGS * ROUNDING["float64"] * conditioning * angle / np.sin(angle)
            assert np.all(error <= bound), (system, tick_s)


@pytest.mark.parametrize(("seed", "filters"), [A_FEW, *MANY])
def test_zoh_is_within_its_bound_of_theory(seed, filters):
    rng = np.random.default_rng(seed)
    for _ in range(filters):
        g, tick_s = random_filter(rng)
        omega = SHARES * math.pi / tick_s
        theory = zoh_exactly(g, omega, tick_s)
        error = np.abs(discretise(g, tick_s, "zoh").frequency_response(omega) - theory)
        assert np.all(error <= 1e-9 * np.abs(theory) + testing.OF_ZOH * np.abs(theory).max()), g


def test_a_zero_that_eigenvalues_take_for_infinite_is_found():
    """Of this filter one of the 11 zeros of the zero-order hold lies at some -2,000."""
    rng = np.random.default_rng(4)
    g, tick_s = next(
        (g, tick_s)
        for g, tick_s in (random_filter(rng, held=True) for _ in range(100))
        if (g.order, len(g.zeros)) == (12, 1)
    )
    omega = SHARES * math.pi / tick_s
    error = np.abs(
        discretise(g, tick_s, "zoh").frequency_response(omega) - zoh_exactly(g, omega, tick_s)
    )
    assert error.max() < 1e-9


@pytest.mark.parametrize(("seed", "filters"), [A_FEW, *MANY])
def test_a_run_is_scipys_sosfilt_of_the_same_sections(seed, filters):
    """Standard sections have fewer digits, so filters that are slow for their tick are left out."""
    rng = np.random.default_rng(seed)
    compared = 0
    for _ in range(filters):
        g, tick_s = random_filter(rng)
        made = discretise(g, tick_s)
        if np.abs(g.poles).min() * tick_s < 1e-2:
            continue
        compared += 1
        u = rng.standard_normal(300)
        expected = signal.sosfilt(made.to_scipy_sos(), u)
        np.testing.assert_allclose(made.run(u), expected, atol=1e-8 * np.abs(expected).max())
    assert compared >= 1


@pytest.mark.parametrize(("seed", "filters"), [A_FEW, *MANY])
def test_at_low_order_it_is_scipys_cont2discrete(seed, filters):
    """scipy works on state spaces of polynomials, which at order 5 have few digits left."""
    rng = np.random.default_rng(seed)
    compared = 0
    for _ in range(filters):
        g, tick_s = random_filter(rng, held=True)
        if g.order > 4 or np.abs(g.poles).min() * tick_s < 1e-3:
            continue
        compared += 1
        omega = np.array([0.01, 0.2, 0.6]) * math.pi / tick_s
        for rule, method in (("tustin", "bilinear"), ("zoh", "zoh")):
            system = (g.numerator(), g.denominator())
            with warnings.catch_warnings():  # of scipy, that its own matrix is ill-conditioned
                warnings.simplefilter("ignore")
                num, den, _ = signal.cont2discrete(system, tick_s, method)
            _, expected = signal.freqz(num[0], den, omega * tick_s)
            answer = discretise(system, tick_s, rule).frequency_response(omega)  # type: ignore[arg-type]
            error = np.abs(answer - expected)
            assert np.all(error <= 1e-5 * np.abs(expected).max()), (g, tick_s, rule)
    assert compared >= 1


@pytest.mark.compiled
@pytest.mark.parametrize(("seed", "filters"), [A_FEW, *MANY])
def test_every_assertion_of_the_testing_module_holds(seed, filters):
    rng = np.random.default_rng(seed)
    for _ in range(filters // 4):
        g, tick_s = random_filter(rng, held=True)
        for rule in ("tustin", "tustin-held", "zoh"):
            made = discretise(g, tick_s, rule)  # type: ignore[arg-type]
            testing.assert_follows(made, g, tick_s=tick_s, rule=rule)  # type: ignore[arg-type]
            testing.assert_dc_gain(made, g)
            testing.assert_stable(made)
            testing.assert_float32_follows(made)
        testing.assert_step(discretise(g, tick_s, "zoh"), g, within=testing.OF_ZOH)
        single = discretise(g, tick_s, precision="float32")
        testing.assert_follows(single, g, tick_s=tick_s, rule="tustin")
