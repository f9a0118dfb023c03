"""The limits set by zeros and poles in the right half plane for every controller.

Under every stabilising controller the sensitivity S is 1 at each right-half-plane zero z of the
plant and 0 at each unstable pole p, and T = 1 - S the reverse. By the maximum modulus principle
(Zames and Francis, IEEE Trans. Automat. Contr. 28 (1983) 585), with a delay d in the loop,

    max |S| >= B(z) = Π |(z + p̄)/(z - p)|,   max |T| >= e^(Re(p) d) Π |(p + z̄)/(p - z)|

and if |S| <= ε up to the frequency ω (seen from z under the angle Θ of 0..π), then (Freudenberg and
Looze, IEEE Trans. Automat. Contr. 30 (1985) 555)

    max |S| >= (1/ε)^(Θ/(π - Θ)) B(z)^(π/(π - Θ))

The same bound without p holds for the rest of a compensated loss, 1 - q N2i: 1 at the zeros of N2,
without further conditions.
"""

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.design.zpk import Roots


@dataclass(frozen=True)
class Limitations:
    """Limits of a loop with these ``zeros`` and ``poles`` in the right half plane, rad/s.

    Attributes:
        sensitivity: least max |S|.
        complementary: least max |T|.
        halving_rad_per_s: largest frequency up to which |S| can be a half with |S| at most 2
            anywhere; infinite without zeros, 0 if impossible.
    """

    zeros: Roots
    poles: Roots
    sensitivity: float
    complementary: float
    halving_rad_per_s: float


def limitations(zeros: Roots, poles: Roots, delay_s: float = 0.0) -> Limitations:
    """The limits of a loop with a delay of ``delay_s`` seconds, no zero on a pole."""
    seen_from = [_blaschke(zero, poles) for zero in zeros]
    return Limitations(
        zeros,
        poles,
        max(seen_from, default=1.0),
        max((math.exp(p.real * delay_s) * _blaschke(p, zeros) for p in poles), default=1.0),
        min(map(_halving, zeros, seen_from), default=math.inf),
    )


def _blaschke(point: complex, roots: Roots) -> float:
    return math.prod(abs((point + root.conjugate()) / (point - root)) for root in roots)


def _halving(zero: complex, least: float) -> float:
    """The ω with 2 = 2^(Θ/(π - Θ)) B^(π/(π - Θ)), hence Θ = π (1 - log2 B)/2.

    Θ = atan((ω - Im z)/Re z) + atan((ω + Im z)/Re z), so tan Θ = 2 ω Re z/(|z|² - ω²).
    """
    angle = 0.5 * math.pi * (1.0 - math.log2(least))
    if angle <= 0.0:
        return 0.0
    a, b, c = math.sin(angle), 2.0 * zero.real * math.cos(angle), math.sin(angle) * abs(zero) ** 2
    return float(max(np.roots([a, b, -c]).real))
