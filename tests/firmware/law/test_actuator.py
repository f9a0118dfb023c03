"""What an actuator makes of a command: magnitude, rate and resolution."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from firmware_model.law.core.actuator import Constants, State, quantise, saturate, saturate_rate
from firmware_model.law.structs import zeroed

some = st.floats(-1e3, 1e3)


def actuator(limit: float = math.inf, slew: float = math.inf, lsb: float = 0.0) -> Any:
    made = zeroed(Constants, "float64")[0]
    made.limit, made.slew, made.lsb = limit, slew, lsb
    return made


def at_rest() -> Any:
    return zeroed(State, "float64")[0]


def test_each_end_of_the_rate_and_of_the_limit():
    """Limits are applied by hand: no limit hides a second limit."""
    motor = actuator(limit=10.0, slew=3.0)
    for command, previous, expected in (
        (8.0, 1.0, 4.0), (-8.0, 1.0, -2.0), (2.0, 1.0, 2.0),
        (99.0, 9.0, 10.0), (-99.0, -9.0, -10.0), (99.0, -9.0, -6.0), (-99.0, 9.0, 6.0),
    ):  # fmt: skip
        assert saturate_rate(motor, command, previous) == expected


@given(st.lists(some, min_size=1, max_size=50), st.sampled_from([1e-3, 0.25, 2.0]))
def test_all_commands_together_are_rounded_once(commands, lsb):
    """First-order noise shaping: by half a step for the sum of all, not for each of them."""
    motor, state = actuator(lsb=lsb), at_rest()
    rounded = [quantise(motor, state, command) for command in commands]
    off = np.cumsum(commands) - np.cumsum(rounded)
    assert np.abs(off).max() <= lsb / 2 * (1 + 1e-9) + 1e-9
    steps = np.array(rounded) / lsb
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)


@given(st.lists(some, min_size=1, max_size=50), st.sampled_from([0.25, 1.0]), st.integers(1, 40))
def test_what_is_left_takes_no_command_beyond_its_limit(commands, lsb, steps):
    """Nor does it pile up there: a command that leaves the limit finds half a step at most."""
    limit = steps * lsb
    motor, state = actuator(limit, lsb=lsb), at_rest()
    for command in commands:
        rounded = quantise(motor, state, saturate(motor, command))
        assert abs(rounded) <= limit
        assert abs(state.rounded_off) <= lsb / 2


def test_a_product_in_single_precision_is_not_beyond_the_limit():
    """400 000 steps of 0.001 are 400.00003 there."""
    motor = zeroed(Constants, "float32")[0]
    motor.limit, motor.slew, motor.lsb = 400.0, math.inf, 1e-3
    for command in (400.0, -400.0):
        state = zeroed(State, "float32")[0]
        assert quantise(motor, state, np.float32(command)) == command
        assert state.rounded_off == 0.0


@pytest.mark.parametrize("command", [math.inf, math.nan])
def test_what_overflowed_leaves_nothing(command):
    motor, state = actuator(lsb=0.5), at_rest()
    quantise(motor, state, 0.2)
    quantise(motor, state, command)
    assert state.rounded_off == 0.0


def test_without_a_resolution_a_command_stays_as_it_is():
    assert quantise(actuator(), at_rest(), 0.123456789) == 0.123456789
    assert quantise(actuator(lsb=1e-3), at_rest(), 0.0125) == 0.012  # ties go to even
