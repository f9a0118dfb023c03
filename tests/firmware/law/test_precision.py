"""A number of a formula takes the precision of the table, compiled and interpreted."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_model.law.precision import real


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_number_takes_the_precision_of_the_table(kind: type[np.floating]) -> None:
    third = real(1.0 / 3.0, kind(7.0))
    assert third == kind(1.0 / 3.0)
    assert np.asarray(third * kind(1.0)).dtype == kind
