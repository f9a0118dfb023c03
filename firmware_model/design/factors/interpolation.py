"""The complementary sensitivity T = q̂ G1i P of any plant, stable and minimum phase or not.

For internal stability T must vanish at the zeros of G1 in the right half plane (the inner factor
G1i ensures so), and be 1 at every unstable pole p (Zames and Francis, IEEE Trans. Automat. Contr.
28 (1983) 585), as it is at s = 0 to track a step. For k such poles,

    P = (1 + c1 s + ... + ck s^k)/(1 + τq s)^k

has as many coefficients. The coefficients make the numerator of 1 - T a multiple of s Π(s - p): a
linear system, also for repeated poles. All polynomials are in x = τq s.
"""

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.design.factors.polynomials import congruent, monic
from firmware_model.design.zpk import Roots


@dataclass(frozen=True)
class Interpolation:
    """The parts of T, roots in rad/s.

    Attributes:
        zeros: of P, at most k.
        gain: leading coefficient of the numerator of P in x.
        remaining: the zeros of 1 - T except s = 0 and the unstable poles.
    """

    zeros: Roots
    gain: float
    remaining: Roots


def interpolate(zeros: Roots, poles: Roots, tau_q_s: float, alpha_q: int) -> Interpolation:
    """P for G1 with these distinct ``zeros`` and ``poles`` in the right half plane.

    Without zeros and poles P = 1, and the roots of 1 - T = 1 - q̂ make 1 + τq s an αq-th root of
    one.
    """
    if not zeros and not poles:
        first, *others = roots_of_one_less_one(alpha_q)
        assert first == 0
        return Interpolation((), 1.0, tuple(root / tau_q_s for root in others))
    scaled_zeros = tuple(tau_q_s * zero for zero in zeros)
    inner = (-1.0) ** len(zeros) * monic(scaled_zeros)
    images = monic(tuple(-zero.conjugate() for zero in scaled_zeros))
    lag = monic((-1.0 + 0j,) * (alpha_q + len(poles)))
    numerator, quotient = congruent(
        inner, np.convolve(images, lag), monic((0j, *(tau_q_s * pole for pole in poles)))
    )
    leading = np.trim_zeros(numerator, "f")
    return Interpolation(
        tuple(complex(root) / tau_q_s for root in np.roots(leading)),
        float(leading[0]) / tau_q_s ** (len(poles) + 1 - len(leading)),
        tuple(complex(root) / tau_q_s for root in np.roots(quotient)),
    )


def roots_of_one_less_one(order: int) -> Roots:
    """``exp(2πik/order) - 1`` for k = 0..order-1; real roots and conjugate pairs are exact."""
    real: Roots = (0j,) if order % 2 else (0j, -2 + 0j)
    # exp(iθ) - 1 = -2 sin²(θ/2) + i sin θ, which does not subtract near-equal numbers
    angles = [2 * math.pi * k / order for k in range(1, (order + 1) // 2)]
    upper = [complex(-2 * math.sin(theta / 2) ** 2, math.sin(theta)) for theta in angles]
    return (*real, *upper, *(root.conjugate() for root in upper))
