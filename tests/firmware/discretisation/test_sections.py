"""Sections in δ: their response, and which roots go together."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, strategies as st

from firmware_model.discretisation.sections import Sections, from_delta_zpk, realisation
from firmware_model.law.core import biquad
from firmware_model.law.structs import zeroed

coefficient = st.sampled_from([0.0, 0.5, -0.7, 1.0, 2.0])
row = st.tuples(*[coefficient] * 5)
OFF_THE_POLES = np.exp(1j * np.linspace(0.3, 3.0, 7)) * 1.37


@given(st.lists(row, min_size=1, max_size=4))
def test_the_response_is_the_product_of_the_fractions(rows):
    """Whichever coefficients are zero: a factor δ/δ changes nothing where δ is not."""
    delta = OFF_THE_POLES - 1.0
    expected = np.ones_like(delta)
    for *above, a1, a2 in rows:
        expected = expected * np.polyval(above, delta) / np.polyval([1.0, a1, a2], delta)
    response = Sections(np.array(rows), 1e-3)(OFF_THE_POLES)
    np.testing.assert_allclose(response, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ((3.0, 0.0, 0.0, 0.0, 0.0), 3.0),  # a gain: 0/0 of the two factors δ
        ((3.0, 4.0, 0.0, 2.0, 0.0), 2.0),  # first order: b1/a1
        ((3.0, 0.0, 0.0, 2.0, 0.0), 0.0),
        ((3.0, 1.0, 6.0, 5.0, 2.0), 3.0),  # second order: b2/a2
    ],
)
def test_at_rest_a_section_of_lower_order_is_no_0_by_0(section, expected):
    assert Sections(np.array([section]), 1e-3)(np.array([1.0]))[0] == expected


def test_a_zero_goes_to_the_nearest_poles():
    """So that no section is much larger than the cascade. By hand: -9 lies at -8 and -10."""
    poles = (-1.0, -2.0, -8.0, -10.0)
    for zero, at in ((-9.0, 1), (-1.2, 0), (-6.0, 1)):
        rows = from_delta_zpk((zero,), poles, 1.0, 1e-3).coefficients
        assert [r[1] != 0.0 for r in rows] == [at == 0, at == 1]
        assert rows[0][3:].tolist() == [3.0, 2.0]
        assert rows[1][3:].tolist() == [18.0, 80.0]


def test_of_a_pair_and_a_single_pole_the_nearer_gets_the_zero():
    """The middle of a pair counts, not its sum: -3 is nearer to -3.5 than to -6 ± j."""
    poles = (-6 + 1j, -6 - 1j, -3.5)
    rows = from_delta_zpk((-3.0,), poles, 1.0, 1e-3).coefficients
    np.testing.assert_allclose(rows[0], [0.0, 0.0, 1.0, 12.0, 37.0])
    np.testing.assert_allclose(rows[1], [1.0, 3.0, 0.0, 3.5, 0.0])
    rows = from_delta_zpk((-5.5,), poles, 1.0, 1e-3).coefficients
    np.testing.assert_allclose(rows[0], [0.0, 1.0, 5.5, 12.0, 37.0])
    np.testing.assert_allclose(rows[1], [0.0, 1.0, 0.0, 3.5, 0.0])


ZERO_OR_NOT = list(product([0.0, 0.25], repeat=4))


@pytest.mark.parametrize("row", ZERO_OR_NOT)
def test_standard_sections_are_the_same_fractions(row):
    """In powers of 1/z, whichever coefficients are zero."""
    sections = Sections(np.array([[0.5, *row]]), 1e-3)
    sos = sections.sos[0]
    back = 1.0 / OFF_THE_POLES
    expected = np.polyval(sos[2::-1], back) / np.polyval(sos[:2:-1], back)
    np.testing.assert_allclose(sections(OFF_THE_POLES), expected, rtol=1e-12)
    _, b2, _, a2 = row
    if b2 == a2 == 0.0:  # and of first order where they are
        assert sos[2] == sos[5] == 0.0


@pytest.mark.parametrize("row", ZERO_OR_NOT)
def test_the_realisation_has_the_accumulators_that_leave_zero(row):
    """In a run of the firmware's cascade, of which this is the second section."""
    rows = np.array([[0.5, 0.3, 0.0, 0.2, 0.0], [0.5, *row]])
    cascade = zeroed(biquad.Constants, "float64")[0]
    cascade.n, cascade.coefficients[:2] = 2, rows
    state = biquad.at_rest("float64")
    for u in (1.0, 0.3, -0.7):
        biquad.advance(cascade, state, u)
    moved = np.flatnonzero(state.accumulators[:2])
    *_, reached = realisation(Sections(rows, 1e-3))
    assert reached == moved.tolist()
