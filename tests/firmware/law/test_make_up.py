"""The make-up of one tick, alone: against least squares over all that comes."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.sections import Sections, make_up_gain
from firmware_model.discretisation.tustin import tustin, zoh
from firmware_model.errors import DesignError
from firmware_model.law.core import actuator, biquad, shortfall
from firmware_model.law.core.shortfall import make_up
from firmware_model.law.structs import zeroed

ROWS = {
    "a lag": [[0.0, 0.3, 0.0, 0.4, 0.0]],
    "a lag with feedthrough": [[0.7, 0.3, 0.0, 0.4, 0.0]],
    "an oscillator": [[0.0, 0.1, 0.3, 0.5, 0.3]],
    "only its second number": [[0.0, 0.0, 0.3, 0.5, 0.3]],
    "two sections": [[0.5, 0.2, 0.05, 0.9, 0.4], [0.2, -0.3, 0.1, 0.6, 0.2]],
    "one of first order before": [[0.3, 0.1, 0.0, 0.5, 0.0], [0.4, 0.2, 0.1, 0.8, 0.3]],
    "one of first order behind": [[0.3, 0.1, 0.2, 0.5, 0.4], [0.4, 0.2, 0.0, 0.6, 0.0]],
    "a gain behind": [[0.3, 0.1, 0.2, 0.5, 0.4], [0.4, 0.0, 0.0, 0.0, 0.0]],
    "the car's G1, exact": zoh(steer_by_wire().g1, 1e-3).coefficients,
    "the car's G2, Tustin's": tustin(steer_by_wire().g2, 1e-3).coefficients,
}
FADED = 6000  # ticks until each output has faded


def records(rows: NDArray[np.float64], slew: float = math.inf) -> list[Any]:
    """Constants of the make-up, the cascade, the actuator, and a state."""
    constants, limits = (
        zeroed(shortfall.Constants, "float64")[0],
        zeroed(actuator.Constants, "float64")[0],
    )
    cascade, state = zeroed(biquad.Constants, "float64")[0], zeroed(shortfall.State, "float64")[0]
    cascade.n = len(rows)
    cascade.coefficients[: len(rows)] = rows
    constants.gain[: len(rows)] = make_up_gain(Sections(rows.copy(), 1e-3))
    limits.slew = slew
    return [constants, cascade, limits, state]


@pytest.mark.parametrize("name", ROWS)
def test_it_leaves_the_least_of_the_missing_output(name):
    """One command acts in this tick."""
    rows = np.array(ROWS[name])
    constants, cascade, limits, state = records(rows)
    short = np.random.default_rng(2).standard_normal(30)
    for value in short.tolist():
        biquad.advance(cascade, state, value)
    sos = Sections(rows.copy(), 1e-3).sos
    free = signal.sosfilt(sos, np.concatenate([short, np.zeros(FADED)]))[len(short) :]
    unit = signal.sosfilt(sos, np.eye(1, FADED)[0])
    best = float(unit @ free / (unit @ unit))
    assert make_up(constants, cascade, limits, state) == pytest.approx(best, rel=1e-6)
    assert abs(best) > 1e-3


def test_however_slow_it_fades():
    """A lag of a million ticks: y = s and the sum of squares of a geometric series."""
    rate = 1e-6
    gain = make_up_gain(Sections(np.array([[0.0, rate, 0.0, rate, 0.0]]), 1e-3))
    # V = y² + P (x⁺)², P = 1/(1 - (1 - r)²), x⁺ = (1 - r) x - r v: least at v = (1 - r) x/r.
    np.testing.assert_allclose(gain, [[(1.0 - rate) / rate, 0.0]], rtol=1e-9)


def test_a_lag_that_double_precision_takes_for_an_integrator_is_refused():
    lag = Sections(np.array([[0.0, 1.0, 0.0, 1e-17, 0.0]]), 1e-3)
    with pytest.raises(DesignError, match="too close to 0 rad/s for double precision"):
        make_up_gain(lag)


def test_what_answers_to_nothing_cannot_make_up():
    rows = np.array([[0.0, 0.0, 0.0, 0.5, 0.1]])
    assert make_up_gain(Sections(rows, 1e-3)).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize(("slew", "given"), [(100.0, -7.0), (5.0, -5.0), (7.0, -7.0)])
def test_it_is_what_can_be_taken_back_within_a_tick(slew, given):
    constants, cascade, limits, state = records(np.array(ROWS["two sections"]), slew)
    constants.gain[:3] = [[1.0, 2.0], [3.0, 4.0], [9.0, 9.0]]
    state.accumulators[:3] = [[1.0, -2.0], [4.0, -4.0], [9.0, 9.0]]  # the third is not in use
    for sign in (1.0, -1.0):
        state.accumulators[:] *= sign
        assert make_up(constants, cascade, limits, state) == sign * given
