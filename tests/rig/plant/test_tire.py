"""The tire against bristles that stick until friction is reached."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_rig.plant.nonlinear_car import brush
from tests.rig.plant.single_track import (
    grips,
    speeds,
    stiffnesses,
)


@pytest.mark.parametrize("slip", [1e-4, 0.01, 0.05, 0.1, 0.2, 0.3, 1.2])
def test_the_tire_is_bristles_that_stick_until_friction_is_reached(slip):
    """Each bristle, 2/n of the contact, bends with its way from the front or slides."""
    stiffness, grip, count = 67400.0, 7506.0, 200_000
    way = (np.arange(count) + 0.5) * 2.0 / count  # contact from 0 to 2
    sticking = stiffness / 2.0 * math.tan(slip) * way
    sliding = 0.75 * grip * (1.0 - (way - 1.0) ** 2)  # a parabola that sums to the grip
    expected = np.minimum(sticking, sliding).mean() * 2.0
    assert brush(stiffness, grip, math.cos(slip), -math.sin(slip)) == pytest.approx(expected, 1e-8)


@given(stiffnesses, grips, speeds.filter(lambda v: abs(v) > 0.1), speeds)
def test_a_tire_is_odd_bounded_and_never_pushes(stiffness, grip, along, across):
    force = brush(stiffness, grip, along, across)
    assert brush(stiffness, grip, along, -across) == -force
    assert brush(stiffness, grip, -along, across) == force  # a wheel that rolls backward
    assert abs(force) <= grip * (1 + 1e-12)
    assert abs(force) <= stiffness * abs(across / along) * (1 + 1e-12)
    assert force * across <= 0.0


@given(stiffnesses, grips, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_more_slip_is_never_less_force(stiffness, grip, one, other):
    less, more = sorted((one, other))
    assert brush(stiffness, grip, 1.0, -less) <= brush(stiffness, grip, 1.0, -more) + 1e-9 * grip


def test_the_cornering_stiffness_is_the_slope_at_zero_slip():
    assert brush(67400.0, 7506.0, 1.0, -1e-9) == pytest.approx(67400e-9, rel=1e-7)
