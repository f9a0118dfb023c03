"""The congruence of polynomials, by multiplying it out."""

import numpy as np
import pytest

from firmware_model.design.factors import congruent, monic


@pytest.mark.parametrize("roots", [(), (2.0,), (1.0, -3.0), (0.5 + 2.0j, 0.5 - 2.0j, 4.0)])
def test_factor_x_and_modulus_quotient_add_up_to_what_is_wanted(roots):
    factor, wanted, modulus = np.array([2.0, 7.0]), np.array([1.0, -4.0, 0.5, 3.0]), monic(roots)
    x, quotient = congruent(factor, wanted, modulus)
    total = np.polyadd(np.polymul(factor, x), np.polymul(modulus, quotient))
    np.testing.assert_allclose(np.polysub(total, wanted), 0.0, atol=1e-12)
    assert len(x) <= max(len(roots), 1)
