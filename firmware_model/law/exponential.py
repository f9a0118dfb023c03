"""e^-x with the same bits on every machine: the math libraries differ in the last bit.

Cody and Waite's reduction: x = n ln 2 + r, |r| ≤ ½ ln 2, so e^-x = 2^-n e^-r. The first part of
ln 2 has 9 bits, so n times it is exact in either precision; e^-r is its series, whose terms are
below a rounding of double precision from the 14th on.
"""

from __future__ import annotations

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.law.precision import real

LN2 = 0.6931471805599453
LN2_FIRST = 0.693359375
LN2_REST = -2.1219444005469058e-4
TERMS = 13
LARGEST = 80.0  # 2e-35, which single precision still holds


@firmware
def exp_minus(x: float) -> float:
    """e^-x for an x of 0 or above, to two roundings; 0 where x is 80 or above."""
    one = real(1.0, x)
    if not x < real(LARGEST, x):
        return real(0.0, x)
    n = np.rint(max(real(0.0, x), x) / real(LN2, x))
    r = (x - n * real(LN2_FIRST, x)) - n * real(LN2_REST, x)
    series, left = one, real(TERMS, x)
    for _ in range(TERMS):
        series = one - series * r / left
        left = left - one
    half = real(0.5, x)
    for _ in range(int(n)):
        series = series * half
    return series
