"""Zeros of c(xI - a)⁻¹b, where x is s or δ, made as exact as the response is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from firmware_model.discretisation.sections import ComplexArray
from firmware_model.target.structs import FloatArray

REFINEMENTS = 16
"""At most; each triples the digits once there are some, more help only zeros that nearly meet."""


def refined(
    a: FloatArray, b: FloatArray, c: FloatArray, poles: ComplexArray, found: Iterable[complex]
) -> list[complex]:
    """Refine the zeros ``found`` by eigenvalues; eigenvalues miss distant zeros by far.

    Aberth's iteration for all at once on the numerator N(x) = c(xI - a)⁻¹b Π(x - pole): the step is
    N/(N' - N Σ 1/(zero - other)). Real zeros stay real, and pairs stay conjugate. Zeros that cancel
    poles stay unchanged.
    """
    found = list(found)
    real = [root for root in found if root.imag == 0.0]
    upper = [root for root in found if root.imag > 0.0]
    zeros = np.array([*real, *upper, *np.conj(upper)], np.complex128)
    for _ in range(REFINEMENTS):
        distance = zeros[:, None] - zeros
        np.fill_diagonal(distance, np.inf)
        resolvent = zeros[:, None, None] * np.eye(len(a)) - a
        try:
            x = np.linalg.solve(resolvent, np.broadcast_to(b, (len(zeros), *b.shape)))
            slope = -(c @ np.linalg.solve(resolvent, x))[:, 0, 0]
        except np.linalg.LinAlgError:  # a zero that cancels a pole
            return found
        with np.errstate(all="ignore"):
            of_others = (1.0 / (zeros[:, None] - poles)).sum(axis=1) - (1.0 / distance).sum(axis=1)
            step = 1.0 / (slope / (c @ x)[:, 0, 0] + of_others)
        before = zeros.copy()
        zeros -= np.where(np.isfinite(step), step, 0.0)  # exact or double zeros stay
        zeros[: len(real)].imag = 0.0
        zeros[len(real) + len(upper) :] = zeros[len(real) : len(real) + len(upper)].conj()
        if (zeros == before).all():
            break
    return [complex(zero) for zero in zeros]
