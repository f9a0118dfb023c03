"""Theorems 2.3.1 and 2.3.2 as identities."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from firmware_model.design.continuous_design import fault_estimator
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain

PLANTS = [chapter_2(), steer_by_wire(), steer_by_wire(variant="published")]
S = 1j * np.logspace(-2, 4, 25)

magnitude = st.floats(0.1, 50.0)
pole_pairs = st.tuples(magnitude, magnitude).map(
    lambda p: (complex(-p[0], p[1]), complex(-p[0], -p[1]))
)
free_parameters = st.builds(
    lambda poles, zeros, gain: ZeroPoleGain(tuple(zeros[: len(poles)]), poles, gain),
    st.one_of(pole_pairs, st.tuples(), magnitude.map(lambda p: (-p,))),
    st.lists(st.floats(-50, 50), max_size=2),
    st.floats(-5, 5),
)


@pytest.mark.compiled
@given(st.sampled_from(PLANTS), free_parameters)
def test_healthy_plant_is_silent_for_every_q(plant, q):
    estimator = fault_estimator(plant.coprime(1.0), q)
    for f1, g in zip(estimator.f1, (plant.g1, plant.g2), strict=True):
        assert f1 == (estimator.f2 * g).scaled(-1.0)  # F1 + F2 G = 0 (2.20), to the last bit
    assert estimator.one_plus_q(S) == pytest.approx(1 + q(S), rel=1e-8, abs=1e-12)
    assert estimator.f2(S) == pytest.approx(-1 - q(S), rel=1e-8, abs=1e-12)
    for f in (*estimator.f1, estimator.f2):
        assert f.is_stable()
        assert f.is_proper


@pytest.mark.parametrize("plant", PLANTS)
def test_without_q_it_is_theorem_2_3_2(plant):
    estimator = fault_estimator(plant.coprime(1.0))
    assert estimator.f1 == (plant.g1, plant.g2)
    assert estimator.f2 == ZeroPoleGain.constant(-1.0)
    assert estimator.one_plus_q == ZeroPoleGain.constant(1.0)
    # (2.30): after the loss d̂ = [G1 0] u
    assert estimator.f1[0](S) == pytest.approx(plant.g1(S))
    assert estimator.f1[1](S) + estimator.f2(S) * plant.g2(S) == pytest.approx(0, abs=1e-15)


def test_a_sum_that_cancels_to_rounding_loses_its_degree():
    # 0.3 - (0.1 + 0.2) is -5.6e-17 in floats: without the rounding rule, d̂ of a tiny gain
    q = ZeroPoleGain((-0.3,), (-(0.1 + 0.2),), -1.0)
    assert fault_estimator(chapter_2().coprime(1.0), q).one_plus_q.gain == 0.0
    high_pass = ZeroPoleGain((0,), (-1,), -1.0)
    assert fault_estimator(chapter_2().coprime(1.0), high_pass).one_plus_q == ZeroPoleGain(
        (), (-1,), 1.0
    )
