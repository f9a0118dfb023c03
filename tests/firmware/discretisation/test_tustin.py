"""Discretisation: identities of each rule, and independent computations of each."""

import math

import mpmath
import numpy as np
import pytest
from scipy import signal

from firmware_model.design.continuous_design import tracking
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections, from_delta_zpk
from firmware_model.discretisation.tustin import RULES, by_rule, tustin, zoh
from firmware_model.errors import ImproperError, ParameterError
from tests.firmware.discretisation.random_filters import zoh_exactly

TICKS_S = (1e-4, 5e-4, 1e-3, 5e-3)


def _filters() -> dict[str, ZeroPoleGain]:
    car, linear = steer_by_wire(), chapter_2()
    return {
        "G1 of the car": car.g1,
        "G2 of the car": car.g2,
        "C of the car": tracking(car.g1, 0.001, 2).controller,
        "compensator of the car": car.g2.inverse() * ZeroPoleGain.lag(0.001, 1),
        "G1 of chapter 2": linear.g1,
        "static": ZeroPoleGain.constant(-2.5),
        "odd order": ZeroPoleGain((-3.0,), (-1.0, -2.0, -5.0), 4.0),
        "single pole with a zero": ZeroPoleGain((-6.0,), (-1.0, -2.0, -5.0), 4.0),
        "zero at the origin": ZeroPoleGain((0.0,), (-1.0, -2.0), 4.0),
    }


FILTERS = _filters()
STRICTLY_PROPER = {name: g for name, g in FILTERS.items() if g.relative_degree > 0}


def _on_circle(tick_s: float, n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    omega = np.geomspace(1e-2, 0.98 * math.pi / tick_s, n)
    return omega, np.exp(1j * omega * tick_s)


@pytest.mark.parametrize("omega", [1.0, 17.7, 300.0])
def test_prewarp_keeps_one_frequency_exactly(omega):
    g, tick_s = FILTERS["G1 of the car"], 5e-3
    sections = tustin(g, tick_s, prewarp_rad_per_s=omega)
    answer = sections(np.exp(np.array([1j * omega * tick_s])))[0]
    assert abs(answer / g(1j * omega) - 1.0) < 1e-11


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("tick_s", TICKS_S)
@pytest.mark.parametrize("name", STRICTLY_PROPER)
def test_dc_gain_and_stability_carry_over(name, tick_s, rule):
    g = STRICTLY_PROPER[name]
    sections = by_rule(rule, g, tick_s)
    assert sections(np.array([1.0 + 0j]))[0].real == pytest.approx(g.dc_gain, rel=1e-12)
    moving = sections.poles[np.abs(sections.poles - 1.0) > 1e-15]
    assert np.all(np.abs(moving) < 1.0)


@pytest.mark.parametrize("tick_s", TICKS_S)
@pytest.mark.parametrize("name", FILTERS)
def test_zoh_equals_the_residues_in_fifty_digits(name, tick_s):
    g = FILTERS[name]
    omega, _ = _on_circle(tick_s, 12)
    exact = zoh_exactly(g, omega, tick_s)
    found = zoh(g, tick_s).at_delta(np.expm1(1j * omega * tick_s))
    # relative to the largest gain nearby: close to a zero only the absolute error means anything
    assert np.all(np.abs(found - exact) < 1e-10 * np.abs(exact) + 1e-17 * abs(g.gain))


@pytest.mark.parametrize("name", STRICTLY_PROPER)
def test_tustin_held_is_crank_nicolson_with_one_input_an_interval(name):
    g, tick_s = STRICTLY_PROPER[name], 5e-3
    a, b, c, _ = signal.zpk2ss(g.zeros, g.poles, g.gain)
    half = a * tick_s / 2.0
    left = np.linalg.inv(np.eye(len(a)) - half)
    phi, gamma = left @ (np.eye(len(a)) + half), left @ b * tick_s
    _, z = _on_circle(tick_s, 12)
    reference = np.array([(c @ np.linalg.solve(p * np.eye(len(a)) - phi, gamma))[0, 0] for p in z])
    np.testing.assert_allclose(by_rule("tustin-held", g, tick_s)(z), reference, rtol=1e-8)


@pytest.mark.parametrize("rule", ["tustin-held", "zoh"])
def test_a_held_input_passes_with_one_tick_of_delay(rule):
    assert by_rule(rule, FILTERS["G2 of the car"], 1e-3).feedthrough == 0.0


def test_zoh_of_integrators_and_growth_equals_the_textbook():
    """Partial fractions, each held: k/s is kT/(z-1), k/(s+a) is k/a (1 - e^{-aT})/(z - e^{-aT})."""
    tick_s, z = 0.01, np.array([1.3 + 0.2j, -0.7 + 0.9j])
    lag = (1.0 - math.exp(-2.0 * tick_s)) / (z - math.exp(-2.0 * tick_s))
    once = tick_s / (z - 1.0)
    twice = tick_s**2 / 2.0 * (z + 1.0) / (z - 1.0) ** 2
    unstable = [  # of δ = e^{aT} - 1 = √2 also 2/δ is the pole
        (ZeroPoleGain((), (at / tick_s,), at / tick_s), math.expm1(at) / (z - math.exp(at)))
        for at in (0.01, math.asinh(1.0), 3.0)
    ]
    for g, expected in (
        *unstable,
        (ZeroPoleGain((), (0.0,), 3.0), 3.0 * once),
        (ZeroPoleGain((), (0.0, 0.0), 3.0), 3.0 * twice),
        (ZeroPoleGain((-1.0,), (0.0, -2.0), 1.0), once / 2.0 + lag / 4.0),
        (ZeroPoleGain((0.0,), (0.0, -2.0), 1.0), lag / 2.0),  # the integrator cancels
    ):
        np.testing.assert_allclose(zoh(g, tick_s)(z), expected, rtol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_nothing_becomes_nothing(rule):
    assert by_rule(rule, ZeroPoleGain.constant(0.0), 1e-3)(np.array([0.3 + 1j])) == 0.0


@pytest.mark.parametrize("tick_s", [0.0, -1e-3, math.nan, math.inf])
@pytest.mark.parametrize("rule", RULES)
def test_a_tick_that_is_no_tick_is_refused(rule, tick_s):
    with pytest.raises(ParameterError, match="tick_s"):
        by_rule(rule, FILTERS["G1 of the car"], tick_s)


@pytest.mark.parametrize("omega", [0.0, -1.0, math.pi / 1e-3, math.nan])
def test_a_prewarp_beyond_nyquist_is_refused(omega):
    with pytest.raises(ParameterError, match="Nyquist"):
        tustin(FILTERS["G1 of the car"], 1e-3, prewarp_rad_per_s=omega)


def test_an_improper_filter_is_refused():
    with pytest.raises(ImproperError, match="improper"):
        zoh(FILTERS["G1 of the car"].inverse(), 1e-3)
    with pytest.raises(ImproperError, match="future"):
        from_delta_zpk([-0.1, -0.2], [-0.3], 1.0, 1e-3)


def test_a_pole_on_the_image_of_infinity_is_refused():
    with pytest.raises(ParameterError, match="infinity"):
        tustin(ZeroPoleGain((), (2000.0,), 1.0), 1e-3)


def test_a_zero_on_the_image_of_infinity_leaves_one_zero_less():
    """Padé's all-pass for a dead time of one tick is one tick of delay, exactly."""
    delay = ZeroPoleGain((2000.0,), (-2000.0,), -1.0)
    z = np.exp(1j * np.array([0.1, 1.0, 3.0]))
    np.testing.assert_allclose(tustin(delay, 1e-3)(z), 1.0 / z, rtol=1e-15)
    held = by_rule("tustin-held", delay * ZeroPoleGain.lag(0.1, 1), 1e-3)
    lag = by_rule("tustin-held", ZeroPoleGain.lag(0.1, 1), 1e-3)
    np.testing.assert_allclose(held(z), lag(z) / z, rtol=1e-13)


def test_sections_are_read_only():
    sections = tustin(FILTERS["G1 of the car"], 1e-3)
    assert isinstance(sections, Sections)
    with pytest.raises(ValueError, match="read-only"):
        sections.coefficients[0, 0] = 1.0


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("tick_s", [1e-3, 1e-7])
def test_a_pole_that_is_slow_for_the_tick_keeps_its_digits(order, tick_s):
    """Poles of 1e-3 rad/s: δ = e^{pT} - 1 is 1e-10 and less, where 1 - e^{pT} has lost 6 digits."""
    poles = [mpmath.mpc(-1e-3, w) for w in ((0.0,) if order == 1 else (2e-3, -2e-3))]
    g = ZeroPoleGain((), tuple(complex(pole) for pole in poles), 1.0)
    with mpmath.workdps(50):
        deltas = [mpmath.expm1(pole * mpmath.mpf(tick_s)) for pole in poles]
        exact = [float(-mpmath.fsum(deltas).real), float(mpmath.fprod(deltas).real)][:order]
    stored = zoh(g, tick_s).coefficients[0, 3 : 3 + order]
    np.testing.assert_allclose(stored, exact, rtol=1e-13)
