"""Left-coprime factors of a stable or unstable plant: [G1 G2] = M⁻¹ [N1 N2], all in RH∞.

The zeros of M are the plant's poles p outside the left half plane; each p has an image p* in the
left half plane as a pole of M:

    M = Π (s - p)/(s - p*),   N1 = M G1,   N2 = M G2

In Theorem 2.3.1 the factors are a choice of the free parameter, 1 + Q = M: F1 of an unstable plant
is stable only if 1 + Q has all p among its zeros. For a stable plant M = 1 and N = G, as in the
thesis.

For a fast p the image is the mirror image, p* = -p̄: M is then all-pass, so white noise in y is as
large and as white in M y, and the decision on d̂ need not know M. The mirror image of a pole on the
imaginary axis (0 included) is the pole itself. So p* lies at least ``slowest_rad_per_s`` to the
left: a high-pass filter follows the sensor of an integrating plant.
"""

from dataclasses import dataclass

from firmware_model.design.zpk import Roots, ZeroPoleGain

SAME_POLE = 1e-6
"""Relative distance up to which poles of two channels are one: those of two polynomials, which are
known to half of the digits where they are double."""

SLOWEST = 0.1
"""Of the bandwidth 1/τq, how far left an image is at least. C and F̂ themselves do not depend on it.
What a limit took off y fades as fast as that; noise above it is as white in d̂ as it is in y."""


@dataclass(frozen=True)
class CoprimeFactors:
    """``denominator`` is M, ``numerators`` are N1 and N2.

    ``slowest_rad_per_s`` is how far left an image is at least.
    """

    denominator: ZeroPoleGain
    numerators: tuple[ZeroPoleGain, ZeroPoleGain]
    slowest_rad_per_s: float


def left_coprime(g1: ZeroPoleGain, g2: ZeroPoleGain, tau_q_s: float) -> CoprimeFactors:
    """M, N1 and N2 of two channels with the same unstable poles; M(∞) = 1.

    ``tau_q_s`` is the time constant of q̂, in seconds.
    """
    slowest = SLOWEST / tau_q_s
    poles = unstable(g1)
    denominator = ZeroPoleGain(poles, tuple(image(p, slowest) for p in poles), 1.0)
    numerators = (_with_images(g1, slowest), _with_images(g2, slowest))
    return CoprimeFactors(denominator, numerators, slowest)


def unstable(g: ZeroPoleGain) -> Roots:
    """The poles of ``g`` in the closed right half plane."""
    return tuple(pole for pole in g.poles if pole.real >= 0)


def image(pole: complex, slowest_rad_per_s: float) -> complex:
    """The pole of M for the zero of M at ``pole``."""
    return complex(-max(pole.real, slowest_rad_per_s), pole.imag)


def _with_images(g: ZeroPoleGain, slowest: float) -> ZeroPoleGain:
    return ZeroPoleGain(
        g.zeros, tuple(image(p, slowest) if p.real >= 0 else p for p in g.poles), g.gain
    )


def with_poles_of(g: ZeroPoleGain, poles: Roots) -> ZeroPoleGain:
    """``g`` with unstable poles moved onto ``poles`` where only rounding separates both."""
    moved = []
    for pole in g.poles:
        near = [p for p in poles if pole.real >= 0 and abs(p - pole) <= SAME_POLE * abs(pole)]
        moved.append(near[0] if near else pole)
    return ZeroPoleGain(g.zeros, tuple(moved), g.gain)
