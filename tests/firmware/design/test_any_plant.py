"""Coprime factors and C of plants that need not be stable or minimum phase: identities of RH∞."""

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from firmware_model.design.continuous_design import tracking
from firmware_model.design.factors import left_coprime, unstable
from firmware_model.design.plants import Plant
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import UnstablePlantError
from tests.firmware.design.test_plants import _assert_channels_are_the_state_space

AXIS = 1j * np.logspace(-2, 3, 30)
LEFT = st.floats(-30, -0.5)
RIGHT_POLE, RIGHT_ZERO = st.floats(0.3, 3.0), st.floats(8.0, 40.0)


def pair(real: float, imaginary: float) -> tuple[complex, complex]:
    return complex(real, imaginary), complex(real, -imaginary)


unstable_poles = st.one_of(
    st.just(()),
    RIGHT_POLE.map(lambda p: (p,)),
    st.floats(0.3, 2.0).map(lambda p: (p, p)),  # repeated
    st.builds(pair, RIGHT_POLE, st.floats(0.5, 4.0)),
    st.sampled_from([(0.0,), (0.0, 0.0), (0.0, 1.5)]),  # that integrate
    st.floats(0.5, 4.0).map(lambda w: pair(0.0, w)),  # that swing
)
right_zeros = st.one_of(
    st.just(()), RIGHT_ZERO.map(lambda z: (z,)), st.builds(pair, RIGHT_ZERO, RIGHT_ZERO)
)
stable_poles = st.lists(LEFT, min_size=1, max_size=3) | st.builds(pair, LEFT, st.floats(0.5, 30.0))
channels = st.builds(
    lambda zeros, left, poles, stable, gain: ZeroPoleGain(
        (*zeros, *left), (*poles, *stable, -20.0, -25.0), gain
    ),
    right_zeros,
    st.lists(LEFT, max_size=1),
    unstable_poles,
    st.lists(LEFT, max_size=2),
    st.sampled_from([1.0, -3.0]),
)


@settings(max_examples=60)
@given(channels, st.floats(0.02, 2.0))
def test_m_has_the_unstable_poles_and_n_is_stable(g, tau_q_s):
    """M is all-pass where all these poles are fast, and a high-pass filter where they are not."""
    factors = left_coprime(g, g, tau_q_s)
    m, n = factors.denominator, factors.numerators[0]
    assert all(pole.real <= -0.1 / tau_q_s for pole in m.poles) and n.is_stable()
    least = min((pole.real for pole in unstable(g)), default=np.inf)
    if least >= 0.1 / tau_q_s:
        assert np.abs(m(AXIS)) == pytest.approx(1.0, rel=1e-12)
    assert np.abs(m(AXIS)).max() <= 1.0 + 1e-12
    assert abs(m(1e7j)) == pytest.approx(1.0, rel=1e-6)
    assert all(abs(m(pole)) == 0.0 for pole in unstable(g))
    assert n(AXIS) / m(AXIS) == pytest.approx(g(AXIS), rel=1e-9)


@settings(max_examples=60)
@given(channels, st.floats(0.02, 0.1), st.integers(6, 7))
def test_c_is_youlas_and_holds_the_plant(g1, tau_q_s, alpha_q):
    """U N1 + V M = 1 with V = 1 - U N1 - R; T as asked; the loop's poles by python-control."""
    made = tracking(g1, tau_q_s, alpha_q)
    factors = left_coprime(g1, g1, tau_q_s)
    m, n = factors.denominator(AXIS), factors.numerators[0](AXIS)
    u, t = made.filter(AXIS), made.complementary(AXIS)
    r = made.stabiliser(AXIS) if made.stabiliser else np.zeros(len(AXIS))
    size = 1.0 + np.abs(t)
    assert np.abs(u * n - t).max() <= 1e-9 * size.max()
    assert np.abs(u * n + (1.0 - u * n - r) * m - 1.0).max() <= 1e-7 * size.max()
    c = u / (1.0 - u * n - r)
    assert np.abs(made.controller(AXIS) / c - 1.0).max() <= 1e-6
    assert made.filter.is_stable() and (made.stabiliser is None) == (not unstable(g1))
    if made.stabiliser is not None:
        assert made.stabiliser.is_stable() and made.stabiliser.relative_degree == 1
    assert made.complementary.dc_gain == pytest.approx(1.0, rel=1e-9)
    for zero in g1.zeros:
        if zero.real > 0:
            assert abs(made.complementary(zero)) <= 1e-9 * size.max()
    loop = control.zpk(
        [*made.controller.zeros, *g1.zeros],
        [*made.controller.poles, *g1.poles],
        made.controller.gain * g1.gain,
    )
    characteristic = np.polyadd(loop.num[0][0], loop.den[0][0])
    assert np.roots(characteristic).real.max() < 0.0


@pytest.mark.compiled
@settings(max_examples=25)
@given(unstable_poles, stable_poles, st.lists(LEFT, max_size=1))
def test_transfer_functions_share_their_unstable_modes(poles, stable, zeros):
    g1 = ZeroPoleGain((-1.0,), (*poles, *stable, -35.0), 2.0)
    g2 = ZeroPoleGain(tuple(zeros), (*poles, -7.0, -12.0), -5.0)
    plant = Plant.from_transfer_functions("made", g1, g2)
    assert len(plant.a) == g1.order + g2.order - len(poles)
    _assert_channels_are_the_state_space(plant, rel=1e-8)


def test_an_unstable_mode_of_one_channel_alone_is_refused():
    stable, other = ZeroPoleGain((), (-1, -2), 1.0), ZeroPoleGain((), (2, -2), 1.0)
    with pytest.raises(UnstablePlantError, match="of G1: 2 rad/s; of G2: none: must be"):
        Plant.from_transfer_functions("made", other, stable)
    nearly = ZeroPoleGain((-3,), (2 * (1 + 1e-9), -2), 1.0)
    assert Plant.from_transfer_functions("made", other, nearly).g2.poles == other.poles


def test_an_inverted_pendulum_by_hand():
    """G1 = k/(s² - p²), αq = 2: with 1 + c1 p = (1 + τp)³ T(p) is 1; s and s - p divide 1 - T."""
    p, tau = 3.0, 0.05
    made = tracking(ZeroPoleGain((), (p, -p), 10.0), tau, 2)
    c1 = ((1 + tau * p) ** 3 - 1) / p
    numerator = np.array([c1, 1.0])
    lag = np.poly([-1 / tau] * 3) * tau**3
    rest, remainder = np.polydiv(np.polysub(lag, numerator), [1.0, -p, 0.0])
    assert np.abs(remainder).max() < 1e-15
    s = 0.3 + 2.0j
    assert made.complementary(s) == pytest.approx(
        np.polyval(numerator, s) / np.polyval(lag, s), rel=1e-12
    )
    expected = np.polyval(numerator, s) * (s + p) / (10.0 * s * np.polyval(rest, s))
    assert made.controller(s) == pytest.approx(expected, rel=1e-12)
