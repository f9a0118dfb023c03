"""A filter whose input is held: responses by scipy's zero-order hold, zeros by the response."""

import numpy as np
import pytest
from scipy import signal

from firmware_model import discretise
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.held_input import response, sampled, zeros_of
from firmware_model.errors import ParameterError

PAIR = (-3.0 + 40.0j, -3.0 - 40.0j)
FILTERS = {
    "a lag": ZeroPoleGain((), (-5.0,), 2.0),
    "an integrator": ZeroPoleGain((), (0.0,), -2.0),
    "a lead": ZeroPoleGain((-7.0,), (-5.0,), 2.0),
    "an integrator and a lag": ZeroPoleGain((), (0.0, -5.0), 3.0),
    "a differentiator and two lags": ZeroPoleGain((0.0,), (-4.0, -5.0), 3.0),
    "a pair": ZeroPoleGain((), PAIR, 900.0),
    "a pair with a zero": ZeroPoleGain((-7.0,), PAIR, 30.0),
    "as many zeros as poles": ZeroPoleGain((-7.0, 2.0), PAIR, 0.5),
    "slow and fast": ZeroPoleGain((-0.3,), (-0.01, -900.0, *PAIR), 1e6),
    "three sections": ZeroPoleGain(PAIR, (-20.0, -30.0, *(2.0 * p for p in PAIR), -1.0), 700.0),
    "feedthrough in between": ZeroPoleGain(
        (-4.0, -5.0, -6.0 + 9.0j, -6.0 - 9.0j), (-20.0, -33.0, *PAIR, -50.0), 9.0
    ),
}


def held(g: ZeroPoleGain, tick_s: float) -> tuple[np.ndarray, ...]:
    """scipy's state space between two ticks, its feedthrough aside."""
    system = signal.ZerosPolesGain(g.zeros, g.poles, g.gain).to_ss()
    a, b, c, *_ = signal.cont2discrete((system.A, system.B, system.C, system.D), tick_s, "zoh")
    return a, b, c


@pytest.mark.parametrize("tick_s", [0.001, 0.05])
@pytest.mark.parametrize("name", FILTERS)
def test_the_response_is_that_of_a_zero_order_hold(name, tick_s):
    g = FILTERS[name]
    a, b, c = held(g, tick_s)
    z = np.exp(1j * np.array([0.01, 0.5, 2.0, 3.1]))
    n = len(a)
    expected = [(c @ np.linalg.solve(x * np.eye(n) - a, b)).item() for x in z]
    found = response(sampled(g, tick_s), z - 1.0)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("tick_s", [0.001, 0.05])
@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("through", [0.0, 0.3])
def test_zeros_are_as_many_as_poles_or_one_less_and_each_is_one(name, tick_s, through):
    """Without feedthrough the answer begins a sample later: one zero less."""
    g = FILTERS[name]
    system = sampled(g, tick_s)
    poles = np.array([np.expm1(p * tick_s) for p in g.poles], np.complex128)
    zeros = zeros_of(system, through, poles)
    assert len(zeros) == len(g.poles) - (not through)
    for zero in zeros:
        near = response(system, zero + np.array([1e-6, 1e-6j]) * (1.0 + abs(zero))) + through
        assert abs(response(system, np.array([zero]))[0] + through) < 1e-3 * np.abs(near).min()


@pytest.mark.parametrize("name", ["slow and fast", "three sections", "feedthrough in between"])
def test_numbers_of_slow_and_fast_sections_are_of_one_size(name):
    """Eigenvalues need input and output matrices of equal size."""
    a, b, c = sampled(FILTERS[name], 0.001)
    assert np.abs(a).max() < 1.0
    assert 1.0 / 8.0 < np.abs(b).max() / np.abs(c).max() < 8.0


@pytest.mark.filterwarnings("error")
def test_a_slow_filter_of_high_order_is_sampled_without_a_warning():
    """Its states differ by more than 2^63; the gain for a constant input is 1."""
    a, b, c = sampled(ZeroPoleGain((), (-1.0,) * 8, 1.0), 1e-6)
    assert (c @ np.linalg.solve(-a, b)).item() == pytest.approx(1.0)


def eulerian(order: int) -> list[int]:
    """Numbers of permutations by their ascents, which are the coefficients."""
    row = [1]
    for n in range(2, order + 1):
        padded = [0, *row, 0]
        row = [(k + 1) * padded[k + 1] + (n - k) * padded[k] for k in range(n)]
    return row


@pytest.mark.parametrize(
    ("order", "pole", "rtol"), [(3, 1e-4, 1e-3), (6, 1e-4, 1e-3), (12, 1.0, 0.06)]
)
def test_zeros_that_sampling_adds_are_those_of_euler_and_frobenius(order, pole, rtol):
    """Of lags that are slow beside the tick: almost of s to the power of -n, held.

    Of twelve, of which the response has two digits left, eigenvalues take one zero for infinite.
    """
    g, tick_s = ZeroPoleGain((), (-pole,) * order, pole**order), 1e-3
    zeros = zeros_of(sampled(g, tick_s), 0.0, np.full(order, np.expm1(-pole * tick_s)) + 0j)
    expected = np.sort(np.roots(eulerian(order)).real)
    np.testing.assert_allclose(np.sort(np.real(zeros)) + 1.0, expected, rtol=rtol)
    assert not np.imag(zeros).any()


@pytest.mark.parametrize("fast", [-1.42e5, -1.5e5, -8e8])
def test_a_pole_far_beyond_the_tick_settles_within_the_tick(fast):
    slow, tick_s = -12.5, 0.01
    g = ZeroPoleGain((), (slow, fast), 3.0 * slow * fast)
    omega = np.array([0.1, 10.0, 300.0])
    z = np.exp(1j * omega * tick_s)
    one = np.expm1(slow * tick_s)  # of the slow mode; the fast one has settled
    expected = 3.0 * (fast / (slow - fast) * one / (z - 1.0 - one) + slow / (slow - fast) / z)
    found = discretise(g, tick_s, "zoh").frequency_response(omega)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_mode_beyond_every_number_within_a_tick_is_refused():
    with pytest.raises(ParameterError, match=r"times the tick is 3e\+03: must be at most 700"):
        discretise(ZeroPoleGain((), (3e5,), 1.0), 0.01, "zoh")
