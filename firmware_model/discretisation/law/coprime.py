"""The left-coprime factors of a plant as it is sampled: [G1 G2] = M⁻¹ [N1 N2] in z.

G1 and G2 are discretised first, by the estimator's rule, and factored then, so that d̂ is as quiet
for a healthy plant as the rule is exact. M has the poles that are not within the unit circle as its
zeros, and of each an image there as a pole: 1/z̄ where the pole is fast, and M then 1 in magnitude
on the circle. At low frequency M goes as the continuous M does, so steady gains agree too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.design.factors.coprime import image, unstable
from firmware_model.design.mismatch import Channels
from firmware_model.design.zpk import ZeroPoleGain
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


def sampled_factors(
    channels: Channels, slowest_rad_per_s: float, rule: Rule, tick_s: float
) -> SampledFactors:
    """M, N1 and N2 of G1 and G2 by ``rule``; how far within images are as in ``left_coprime``.

    Raises:
        DesignError: what the rule refuses.
    """
    poles = unstable(channels[0])
    if not poles:
        g1, g2 = (RULES[rule](g, tick_s) for g in channels)
        return SampledFactors(Sections(UNITY, tick_s), (g1, g2))
    _, outside, _ = DELTA_ROOTS[rule](ZeroPoleGain((), poles, 1.0), tick_s)
    images, gain = [], 1.0
    for pole, sampled in zip(poles, outside, strict=True):
        if pole.real >= slowest_rad_per_s:  # M is all-pass
            images.append(_mirrored(sampled))
            gain *= 1.0 / abs(1.0 + sampled)
        else:
            images.append(_drawn_in(sampled, slowest_rad_per_s * tick_s))
            change = abs(sampled / pole) if pole else tick_s  # dδ/ds
            gain *= abs(images[-1] / image(pole, slowest_rad_per_s)) / change
    n1, n2 = (
        _with_images(DELTA_ROOTS[rule](g, tick_s), dict(zip(outside, images, strict=True)), gain)
        for g in channels
    )
    return SampledFactors(
        from_delta_zpk(outside, images, gain, tick_s),
        (from_delta_zpk(*n1, tick_s), from_delta_zpk(*n2, tick_s)),
    )


def _with_images(roots: DeltaRoots, images: dict[complex, complex], gain: float) -> DeltaRoots:
    zeros, poles, own = roots
    return zeros, [images.get(pole, pole) for pole in poles], own * gain


def _mirrored(pole: complex) -> complex:
    """1/z̄ - 1 of z = 1 + δ."""
    return -pole.conjugate() / (1.0 + pole.conjugate())


def _drawn_in(pole: complex, decay: float) -> complex:
    """e^-decay z/|z| - 1 of z = 1 + δ."""
    direction = (1.0 + pole) / abs(1.0 + pole)
    return math.expm1(-decay) * direction + (direction - 1.0)
