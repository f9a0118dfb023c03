"""The filters that run, against scipy's, and their settled states."""

from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.design.plants import steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.tustin import tustin, zoh
from firmware_model.law.core.biquad import Constants, advance, at_rest, output, settle
from firmware_model.law.structs import MAX_SECTIONS, zeroed

CAR = steer_by_wire()
FILTERS = {
    "G1": zoh(CAR.g1, 1e-3),
    "G2": tustin(CAR.g2, 1e-3),
    "compensator": tustin(CAR.g2.inverse() * ZeroPoleGain.lag(0.001, 1), 1e-3),
    "odd order": tustin(ZeroPoleGain((-3.0,), (-1.0, -2.0, -5.0), 4.0), 1e-2),
    "static": tustin(ZeroPoleGain.constant(-2.5), 1e-3),
}


def cascade_of(coefficients: np.ndarray) -> Any:
    cascade = zeroed(Constants, "float64")[0]
    cascade.n = len(coefficients)
    cascade.coefficients[: cascade.n] = coefficients
    return cascade


def run(sections: Sections, inputs: np.ndarray) -> np.ndarray:
    cascade, state = cascade_of(sections.coefficients), at_rest()
    return np.array([advance(cascade, state, u) for u in inputs])


@pytest.mark.parametrize("name", FILTERS)
def test_equals_scipys_second_order_sections(name):
    inputs = np.random.default_rng(1).standard_normal(4000)
    expected = signal.sosfilt(FILTERS[name].sos, inputs)
    np.testing.assert_allclose(
        run(FILTERS[name], inputs), expected, atol=1e-9 * np.abs(expected).max()
    )


@pytest.mark.parametrize("name", FILTERS)
def test_output_is_what_advance_answers_and_moves_nothing(name):
    cascade, state = cascade_of(FILTERS[name].coefficients), at_rest()
    before = np.random.default_rng(2).standard_normal(state.accumulators.shape)
    state.accumulators[:] = before
    answer = output(cascade, state, 0.7)
    np.testing.assert_array_equal(state.accumulators, before)
    assert answer == advance(cascade, state, 0.7)


@pytest.mark.parametrize("name", FILTERS)
def test_settle_is_where_a_constant_input_leads(name):
    sections = FILTERS[name]
    cascade, state = cascade_of(sections.coefficients), at_rest()
    settled = settle(cascade, state, 3.0)
    dc_gain = sections(np.array([1.0 + 0j]))[0].real
    assert settled == pytest.approx(3.0 * dc_gain, rel=1e-12)
    for _ in range(2000):
        settled = advance(cascade, state, 3.0)
    assert settled == pytest.approx(3.0 * dc_gain, rel=1e-9)


def test_settle_leaves_an_integrator_at_rest():
    cascade, state = cascade_of(np.array([[0.2, 0.1, 0.0, 0.0, 0.0]])), at_rest()
    assert settle(cascade, state, 0.0) == 0.0
    np.testing.assert_array_equal(state.accumulators, 0.0)


@pytest.mark.parametrize(("precision", "size"), [("float64", 8), ("float32", 4)])
def test_a_section_needs_two_numbers_of_memory(precision, size):
    assert at_rest(precision).nbytes == MAX_SECTIONS * 2 * size
    assert not at_rest(precision).accumulators.any()
