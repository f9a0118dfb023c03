"""Any stable filter of order 1 to 12 at any tick, against theory in fifty digits."""

import math

import numpy as np
import pytest

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
