"""What an actuator makes of a command: magnitude, rate and resolution, against numpy's clip."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from firmware_model.target.actuator import CONSTANTS, quantise, saturate, saturate_rate
from firmware_model.target.structs import Record, record_type

some = st.floats(-1e3, 1e3)
size = st.floats(1e-3, 1e3)  # of a limit


def actuator(limit: float = math.inf, slew: float = math.inf, lsb: float = 0.0) -> Record:
    made = np.zeros(1, record_type(CONSTANTS, "float64"))[0]
    made.limit, made.slew, made.lsb = limit, slew, lsb
    return made


@given(some, size)
def test_a_command_is_clipped_at_both_limits(command: float, limit: float) -> None:
    assert saturate(actuator(limit), command) == np.clip(command, -limit, limit)


@given(some, some, size, size)
def test_its_rate_is_clipped_too_and_the_limit_comes_first(
    command: float, previous: float, limit: float, slew: float
) -> None:
    previous = float(np.clip(previous, -limit, limit))
    within_rate = np.clip(command, previous - slew, previous + slew)
    expected = np.clip(within_rate, -limit, limit)
    assert saturate_rate(actuator(limit, slew), command, previous) == expected


def test_each_end_of_the_rate_and_of_the_limit() -> None:
    """By hand, so that no clipping hides another."""
    motor = actuator(limit=10.0, slew=3.0)
    for command, previous, expected in (
        (8.0, 1.0, 4.0), (-8.0, 1.0, -2.0), (2.0, 1.0, 2.0),
        (99.0, 9.0, 10.0), (-99.0, -9.0, -10.0), (99.0, -9.0, -6.0), (-99.0, 9.0, 6.0),
    ):  # fmt: skip
        assert saturate_rate(motor, command, previous) == expected


@given(some, st.sampled_from([1e-3, 0.25, 2.0]))
def test_a_command_is_the_nearest_multiple_of_its_resolution(command: float, lsb: float) -> None:
    rounded = quantise(actuator(lsb=lsb), command)
    assert abs(rounded - command) <= lsb / 2 * (1 + 1e-9)
    assert rounded / lsb == round(rounded / lsb, 6)


def test_without_a_resolution_a_command_stays_as_it_is() -> None:
    assert quantise(actuator(), 0.123456789) == 0.123456789
    assert quantise(actuator(lsb=1e-3), 0.0125) == 0.012  # ties go to even
