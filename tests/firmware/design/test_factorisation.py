"""Inner-outer factorisation: all-pass, minimum phase, and their product the original."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from firmware_model.design.continuous_design import inner_outer
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import AxisZeroError, UnstablePlantError, ZeroChannelError

AXIS = 1j * np.concatenate([-np.logspace(3, -3, 20), [0], np.logspace(-3, 3, 20)])
DENOMINATOR = [1, 27.8684, 494.8547, 5616.1, 20333]

away = st.floats(0.1, 30) | st.floats(-30, -0.1)
zero_lists = st.builds(
    lambda real, pairs: tuple(real) + tuple(complex(a, s * b) for a, b in pairs for s in (1, -1)),
    st.lists(away, max_size=3),
    st.lists(st.tuples(away, st.floats(0.1, 30)), max_size=2),
)
channels = st.builds(
    ZeroPoleGain, zero_lists, st.just((-1.0,) * 7), st.floats(0.1, 9) | st.just(-2)
)


@given(channels)
def test_factors(g):
    inner, outer = inner_outer(g)
    assert np.abs(inner(AXIS)) == pytest.approx(1.0, rel=1e-12)
    assert inner.dc_gain == 1.0
    assert inner(0j) == pytest.approx(1.0, abs=1e-14)
    assert inner.is_stable()
    assert outer.is_stable()
    assert all(zero.real < 0 for zero in outer.zeros)
    assert outer.relative_degree == g.relative_degree
    assert (inner * outer).cancelled() == g.cancelled()
    assert (inner * outer)(AXIS) == pytest.approx(g(AXIS), rel=1e-12)


@pytest.mark.parametrize(
    "g", [chapter_2().g2, steer_by_wire().g2, steer_by_wire(variant="published").g2]
)
def test_a_minimum_phase_channel_is_its_own_outer_factor(g):
    assert inner_outer(g) == (ZeroPoleGain.constant(1.0), g)


@pytest.mark.parametrize(
    "zeros", [(0,), (2j, -2j), (1e-7 + 1j, 1e-7 - 1j), (-1e-7 + 1j, -1e-7 - 1j), (0, -3)]
)
def test_axis_zeros_are_refused(zeros):
    with pytest.raises(AxisZeroError, match=r"G has a zero at .* rad/s, on the imaginary axis"):
        inner_outer(ZeroPoleGain(zeros, (-1, -2, -3), 1.0))


def test_a_double_axis_zero_split_by_rounding_is_refused():
    split = ZeroPoleGain.from_coefficients(np.polymul([1, 0, 7.3], [1, 0, 7.3]), DENOMINATOR)
    with pytest.raises(AxisZeroError):
        inner_outer(split)


def test_a_lightly_damped_zero_is_clear_of_the_axis():
    assert inner_outer(ZeroPoleGain((2e-6 + 1j, 2e-6 - 1j), (-1, -2), 1.0))[0].order == 2
    with pytest.raises(AxisZeroError, match=r"within a damping ratio of 1e-06"):
        inner_outer(ZeroPoleGain((5e-7 + 1j, 5e-7 - 1j), (-1, -2), 1.0))


def test_zero_and_unstable_channels_are_refused():
    with pytest.raises(ZeroChannelError, match=r"G\(s\) is identically zero"):
        inner_outer(ZeroPoleGain.constant(0.0))
    for pole in (0.0, 3.0):
        with pytest.raises(UnstablePlantError, match=f"G has a pole at {pole:.6g}"):
            inner_outer(ZeroPoleGain((), (pole, -1), 1.0))
