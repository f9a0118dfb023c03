"""Left-coprime factors in z, against scipy's discretisation of the plant they came from."""

import numpy as np
import pytest
from scipy import signal

from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.coprime import sampled_factors
from firmware_model.discretisation.tustin import RULES, by_rule, zoh

TICK_S = 0.004
Z = np.exp(1j * np.geomspace(1e-3, np.pi, 50))
PENDULUM = Plant.from_transfer_functions(
    "pendulum", ZeroPoleGain((), (3, -3, -50), 100.0), ZeroPoleGain((-2,), (3, -3, -20), 7.0)
)
WEAVING = Plant.from_transfer_functions(
    "weaving",
    ZeroPoleGain((30,), (1 + 4j, 1 - 4j, -5), -2.0),
    ZeroPoleGain((-2, -8), (1 + 4j, 1 - 4j, -20), 7.0),
)
SATELLITE = Plant.from_transfer_functions(
    "satellite", ZeroPoleGain((), (0, 0, -50), 100.0), ZeroPoleGain((-2,), (0, 0, -20), 7.0)
)
SWINGING = Plant.from_transfer_functions(
    "swinging", ZeroPoleGain((), (4j, -4j, 0), -2.0), ZeroPoleGain((-8,), (4j, -4j, 0), 7.0)
)
UNSTABLE = {"pendulum": PENDULUM, "weaving": WEAVING}
ON_THE_AXIS = {"satellite": SATELLITE, "swinging": SWINGING}
SLOWEST = 0.7  # rad/s, below the real parts of the poles of UNSTABLE


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", UNSTABLE)
def test_m_is_all_pass_in_z_and_n_is_m_times_the_sampled_plant(name, rule):
    plant = UNSTABLE[name]
    factors = sampled_factors((plant.g1, plant.g2), SLOWEST, rule, TICK_S)
    m = factors.denominator(Z)
    assert np.abs(m) == pytest.approx(1.0, rel=1e-12)
    for n, g in zip(factors.numerators, (plant.g1, plant.g2), strict=True):
        assert np.abs(n.poles[n.poles != 1.0]).max() < 1.0
        sampled = by_rule(rule, g, TICK_S)
        assert np.abs(sampled.poles).max() > 1.0
        assert n(Z) == pytest.approx(m * sampled(Z), rel=1e-10)
    at_rest = np.array([0j])
    steady = plant.coprime(0.1 / SLOWEST).denominator(0j)
    assert factors.denominator.at_delta(at_rest)[0] == pytest.approx(steady, rel=1e-12)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", ON_THE_AXIS)
def test_a_plant_on_the_axis_is_heard_through_a_high_pass_filter(name, rule):
    """That of the continuous M at frequencies far below the tick, its poles e^-λT within."""
    plant = ON_THE_AXIS[name]
    factors = sampled_factors((plant.g1, plant.g2), SLOWEST, rule, TICK_S)
    m, continuous = factors.denominator, plant.coprime(0.1 / SLOWEST)
    assert np.abs(m.poles[m.poles != 1.0]) == pytest.approx(np.exp(-SLOWEST * TICK_S), rel=1e-12)
    assert np.abs(m(Z)).max() <= 1.002
    slow = np.array([1e-4, 1e-2, 1.0, 3.0])
    at = np.expm1(1j * slow * TICK_S)
    assert m.at_delta(at) == pytest.approx(continuous.denominator(1j * slow), rel=3e-3)
    at_rest = np.array([0j])
    for n, g, own in zip(
        factors.numerators, (plant.g1, plant.g2), continuous.numerators, strict=True
    ):
        assert np.abs(n.poles[n.poles != 1.0]).max() < 1.0
        assert n(Z) == pytest.approx(m(Z) * by_rule(rule, g, TICK_S)(Z), rel=1e-10)
        assert n.at_delta(at_rest)[0] == pytest.approx(own.dc_gain, rel=1e-10)


@pytest.mark.parametrize("name", UNSTABLE | ON_THE_AXIS)
def test_the_held_plant_is_scipys(name):
    plant = (UNSTABLE | ON_THE_AXIS)[name]
    factors = sampled_factors((plant.g1, plant.g2), SLOWEST, "zoh", TICK_S)
    a, b, c, *_ = signal.cont2discrete((plant.a, plant.b, plant.c, np.zeros((1, 2))), TICK_S)
    response = np.array([c @ np.linalg.solve(z * np.eye(len(a)) - a, b) for z in Z])[:, 0]
    for channel, n in enumerate(factors.numerators):
        assert n(Z) / factors.denominator(Z) == pytest.approx(response[:, channel], rel=1e-8)


def test_of_a_stable_plant_nothing_changes():
    plant = steer_by_wire()
    for rule in RULES:
        factors = sampled_factors((plant.g1, plant.g2), SLOWEST, rule, TICK_S)
        assert len(factors.denominator.coefficients) == 0
        assert (factors.denominator(Z) == 1.0).all() and factors.denominator.feedthrough == 1.0
        for n, g in zip(factors.numerators, (plant.g1, plant.g2), strict=True):
            assert (n.coefficients == by_rule(rule, g, TICK_S).coefficients).all()


@pytest.mark.parametrize("poles", [(3.0,), (2.0, -5.0), (1.0, 40.0), (1 + 3j, 1 - 3j)])
def test_an_unstable_filter_is_held_as_scipy_holds_it(poles):
    """The gain is read off right of all poles: at the mean of their sizes one may be in the way."""
    g = ZeroPoleGain((), poles, 2.0)
    num, den, _ = signal.cont2discrete((g.numerator(), g.denominator()), TICK_S)
    expected = np.polyval(num[0], Z) / np.polyval(den, Z)
    assert zoh(g, TICK_S)(Z) == pytest.approx(expected, rel=1e-9)
