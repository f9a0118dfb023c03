"""The left-coprime factors of a sampled plant: [G1 G2] = M⁻¹ [N1 N2] in z.

The estimator's rule first discretises G1 and G2; the factorisation follows. So d̂ of a healthy
plant is as quiet as the rule is exact. The zeros of M are the poles outside the unit circle; each
has an image inside the circle as a pole of M: 1/z̄ for a fast pole, so M is 1 in magnitude on the
circle. At low frequency M goes as the continuous M does, so steady gains agree too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_model.design.factors import image, unstable
from firmware_model.design.mismatch import Channels
from firmware_model.design.zpk import Roots, ZeroPoleGain
from firmware_model.discretisation.rules import Rule
from firmware_model.discretisation.sections import Sections, from_delta_zpk
from firmware_model.discretisation.tustin import RULES

UNITY = np.zeros((0, 5))
"""The coefficients of no section: what goes in comes out."""


@dataclass(frozen=True)
class SampledFactors:
    """``denominator`` is M, of a stable plant no section at all; ``numerators`` are N1 and N2.

    ``images`` are the poles of M in δ, ``gain`` is its gain.
    """

    denominator: Sections
    numerators: tuple[Sections, Sections]
    images: tuple[complex, ...] = ()
    gain: float = 1.0


def sampled_factors(
    channels: Channels, slowest_rad_per_s: float, rule: Rule, tick_s: float
) -> SampledFactors:
    """M, N1 and N2 of G1 and G2 by ``rule``; how far within images are as in ``left_coprime``.

    Raises:
        DesignError: what the rule refuses.
    """
    poles = unstable(channels[0])
    images: list[complex] = []
    gain = 1.0
    for pole, sampled in zip(poles, _sampled(poles, rule, tick_s), strict=True):
        if pole.real >= slowest_rad_per_s:  # M is all-pass
            images.append(_mirrored(sampled))
            gain *= 1.0 / abs(1.0 + sampled)
        else:
            images.append(_drawn_in(sampled, slowest_rad_per_s * tick_s))
            change = abs(sampled / pole) if pole else tick_s  # dδ/ds
            gain *= abs(images[-1] / image(pole, slowest_rad_per_s)) / change
    return _over(channels, images, gain, rule, tick_s)


def sampled_over(
    channels: Channels, model: SampledFactors, rule: Rule, tick_s: float
) -> SampledFactors:
    """M, N1 and N2 of another plant over the images of ``model``: M y = N1 u1 + N2 u2.

    The plant's rightmost poles replace the unstable poles of the model.
    """
    return _over(channels, model.images, model.gain, rule, tick_s)


def _over(
    channels: Channels, images: Sequence[complex], gain: float, rule: Rule, tick_s: float
) -> SampledFactors:
    outside = _sampled(_rightmost(channels[0], len(images)), rule, tick_s)
    numerators = []
    for g in channels:
        zeros, poles, own = RULES[rule](g, tick_s)
        moved = _sampled(_rightmost(g, len(images)), rule, tick_s)
        inside = dict(zip(moved, images, strict=True))
        kept = [inside.get(pole, pole) for pole in poles]
        numerators.append(from_delta_zpk(zeros, kept, own * gain, tick_s))
    n1, n2 = numerators
    m = from_delta_zpk(outside, images, gain, tick_s) if images else Sections(UNITY, tick_s)
    return SampledFactors(m, (n1, n2), tuple(images), gain)


def _rightmost(g: ZeroPoleGain, count: int) -> Roots:
    """The ``count`` poles with the largest real parts, in the order of ``g``."""
    found = sorted(g.poles, key=lambda pole: -pole.real)[:count]
    return tuple(pole for pole in g.poles if pole in found)


def _sampled(poles: Roots, rule: Rule, tick_s: float) -> list[complex]:
    """``poles`` in δ."""
    if not poles:
        return []
    _, sampled, _ = RULES[rule](ZeroPoleGain((), poles, 1.0), tick_s)
    return sampled


def _mirrored(pole: complex) -> complex:
    """1/z̄ - 1 of z = 1 + δ."""
    return -pole.conjugate() / (1.0 + pole.conjugate())


def _drawn_in(pole: complex, decay: float) -> complex:
    """e^-decay z/|z| - 1 of z = 1 + δ."""
    direction = (1.0 + pole) / abs(1.0 + pole)
    return math.expm1(-decay) * direction + (direction - 1.0)
