"""The bounds of Zames, Francis, Freudenberg and Looze: functions that obey or attain them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import integrate

from firmware_model.design.continuous_design import tracking
from firmware_model.design.factors import limitations, unstable
from firmware_model.design.zpk import ZeroPoleGain
from tests.firmware.design.test_any_plant import channels

AXIS = 1j * np.geomspace(1e-3, 1e4, 4000)


@settings(max_examples=60)
@given(channels, st.floats(0.02, 0.3))
def test_every_c_obeys_them(g1, tau_q_s):
    t = tracking(g1, tau_q_s, 6).complementary(AXIS)
    zeros = tuple(zero for zero in g1.zeros if zero.real > 0)
    found = limitations(zeros, unstable(g1))
    assert np.abs(t).max() >= found.complementary * (1 - 1e-3)
    assert np.abs(1 - t).max() >= found.sensitivity * (1 - 1e-3)
    if zeros and np.abs(1 - t).max() <= 2.0:
        halved = np.abs(1 - t) <= 0.5
        assert AXIS[halved.cumprod().sum()].imag <= found.halving_rad_per_s * (1 + 1e-2)


@given(st.floats(0.1, 9.0), st.floats(10.0, 90.0))
def test_one_zero_and_one_pole_attain_them(p, z):
    """S = B (s - p)/(s + p) is 1 at z and 0 at p, T = B' (z - s)/(z + s) the reverse."""
    found = limitations((z,), (p,))
    s = found.sensitivity * ZeroPoleGain((p,), (-p,), 1.0)(complex(z))
    t = found.complementary * ZeroPoleGain((z,), (-z,), -1.0)(complex(p))
    assert s == pytest.approx(1.0, rel=1e-12) and t == pytest.approx(1.0, rel=1e-12)
    late = limitations((z,), (p,), 0.01)
    assert late.complementary == pytest.approx(found.complementary * math.exp(0.01 * p))
    assert late.sensitivity == found.sensitivity


@given(st.floats(0.5, 20.0), st.floats(0.0, 30.0), st.floats(0.02, 0.15))
def test_the_angle_is_poissons_integral(a, b, p):
    """ln 2 is ln|S| = -ln 2 within ω and +ln 2 without, weighted by what z sees, and π ln B."""
    zero, pole = complex(a, b), complex(p)
    found = limitations((zero,), (pole,))
    omega = found.halving_rad_per_s
    weight, _ = integrate.quad(
        lambda w: a / (a * a + (w - b) ** 2), -omega, omega, points=[min(b, omega)], limit=200
    )
    balance = -math.log(2.0) * weight + math.log(2.0) * (math.pi - weight)
    least = abs((zero + pole) / (zero - pole))
    assert balance == pytest.approx(math.pi * math.log(least), abs=1e-6)


def test_of_a_stable_minimum_phase_plant_nothing_is_impossible():
    found = limitations((), ())
    assert (found.sensitivity, found.complementary) == (1.0, 1.0)
    assert found.halving_rad_per_s == math.inf
    assert limitations((5.0,), ()).halving_rad_per_s == pytest.approx(5.0)
    assert limitations((5.0,), (4.0,)).halving_rad_per_s == 0.0  # |S| of 9 at least
