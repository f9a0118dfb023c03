"""The command that makes up best for an output that is missing, by one tick of it."""

from __future__ import annotations

import numpy as np

from firmware_model.discretisation.sections import Sections
from firmware_model.target.structs import FloatArray


def make_up_gain(sections: Sections) -> FloatArray:
    """The gain of ``target.filters.shortfall`` for a stable model G, shape (n, 2), n its sections.

    With x⁺ = A x - B v, y = c x - d v over the accumulators that signals reach, v minimises

        y² + x⁺ᵀ P x⁺,  P = Aᵀ P A + cᵀ c:   v = (d c + Bᵀ P A) x/(d² + Bᵀ P B).
    """
    a, b, c, d, reached = _realisation(sections)
    energy = _energy(a, c)
    above, below = d * c + b @ energy @ a, d * d + b @ energy @ b
    gain = np.zeros(2 * len(sections.coefficients))
    if below > 0.0:
        gain[reached] = above / below
    return gain.reshape(-1, 2)


def _energy(a: FloatArray, c: FloatArray) -> FloatArray:
    """P = Σ (Aᵀ)ᵏ cᵀ c Aᵏ of a stable A, by doubling: no digits are lost, however slow A is."""
    energy, power = np.outer(c, c), a
    while power.any():
        energy = energy + power.T @ energy @ power
        power = power @ power
    return energy


def _realisation(
    sections: Sections,
) -> tuple[FloatArray, FloatArray, FloatArray, float, list[int]]:
    """A, B, c, d of the cascade over the accumulators of ``biquad`` that ever leave zero."""
    size = 2 * len(sections.coefficients)
    a, b, c, d = np.zeros((size, size)), np.zeros(size), np.zeros(size), 1.0
    reached = []
    for i, (b0, b1, b2, a1, a2) in enumerate(sections.coefficients):
        first, second = 2 * i, 2 * i + 1
        reached += [first] * bool(b1 or a1 or b2 or a2) + [second] * bool(b2 or a2)
        y, direct = b0 * c, b0 * d  # of this section, with c and d its input
        y[first] += 1.0
        a[first, [first, second]] = 1.0
        a[second, second] = 1.0
        for row, beta, alpha in ((first, b1, a1), (second, b2, a2)):
            a[row] += beta * c - alpha * y
            b[row] = beta * d - alpha * direct
        c, d = y, direct
    return a[np.ix_(reached, reached)], b[reached], c[reached], d, reached
