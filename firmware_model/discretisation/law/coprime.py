"""The left-coprime factors of a plant as it is sampled: [G1 G2] = M⁻¹ [N1 N2] in z.

G1 and G2 are discretised first, by the estimator's rule, and factored then, so that d̂ is as quiet
for a healthy plant as the rule is exact. M has the poles outside the unit circle as its zeros and
their images 1/z̄ as its poles, and is 1 in magnitude on the circle; at z = 1 it is what the
continuous M is at s = 0, so steady gains agree too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.design.factors.coprime import unstable
from firmware_model.design.plants import Plant
from firmware_model.discretisation.rules import Rule
from firmware_model.discretisation.sections import Sections, from_delta_zpk
from firmware_model.discretisation.tustin import DELTA_ROOTS, RULES, DeltaRoots

UNITY = np.zeros((0, 5))
"""The coefficients of no section: what goes in comes out."""


@dataclass(frozen=True)
class SampledFactors:
    """``denominator`` is M, of a stable plant no section at all; ``numerators`` are N1 and N2."""

    denominator: Sections
    numerators: tuple[Sections, Sections]


def sampled_factors(plant: Plant, rule: Rule, tick_s: float) -> SampledFactors:
    """M, N1 and N2 of ``plant`` by ``rule``.

    Raises:
        DesignError: what the rule refuses.
    """
    if not unstable(plant.g1):
        g1, g2 = (RULES[rule](g, tick_s) for g in (plant.g1, plant.g2))
        return SampledFactors(Sections(UNITY, tick_s), (g1, g2))
    first, second = (DELTA_ROOTS[rule](g, tick_s) for g in (plant.g1, plant.g2))
    outside = [pole for pole in first[1] if _is_outside(pole)]
    gain = math.prod(1.0 / abs(1.0 + pole) for pole in outside)
    n1, n2 = (_with_images(roots, gain) for roots in (first, second))
    return SampledFactors(
        from_delta_zpk(outside, [_image(pole) for pole in outside], gain, tick_s),
        (from_delta_zpk(*n1, tick_s), from_delta_zpk(*n2, tick_s)),
    )


def _with_images(roots: DeltaRoots, gain: float) -> DeltaRoots:
    zeros, poles, own = roots
    return zeros, [_image(pole) if _is_outside(pole) else pole for pole in poles], own * gain


def _is_outside(pole: complex) -> bool:
    """|1 + δ| > 1, without adding 1 to a small number."""
    return pole.real * (2.0 + pole.real) + pole.imag**2 > 0.0


def _image(pole: complex) -> complex:
    """1/z̄ - 1 of z = 1 + δ."""
    return -pole.conjugate() / (1.0 + pole.conjugate())
