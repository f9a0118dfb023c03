"""Left-coprime factors of a plant that need not be stable: [G1 G2] = M⁻¹ [N1 N2], all in RH∞.

M has the unstable poles p of the plant as its zeros, and their mirror images as its poles:

    M = Π (s - p)/(s + p̄),   N1 = M G1,   N2 = M G2

In Theorem 2.3.1 that is a choice of the free parameter, 1 + Q = M: the only ones that keep F1 of an
unstable plant stable have all p among their zeros. M is all-pass, so white noise in y is as large
and as white in M y: what decides on d̂ need not know of it. Of a stable plant M = 1 and N = G, the
thesis's own.
"""

from dataclasses import dataclass

from firmware_model.design.zpk import Roots, ZeroPoleGain

SAME_POLE = 1e-6
"""Relative distance up to which poles of two channels are one: those of two polynomials, which are
known to half of the digits where they are double."""


@dataclass(frozen=True)
class CoprimeFactors:
    """``denominator`` is M, ``numerators`` are N1 and N2."""

    denominator: ZeroPoleGain
    numerators: tuple[ZeroPoleGain, ZeroPoleGain]


def left_coprime(g1: ZeroPoleGain, g2: ZeroPoleGain) -> CoprimeFactors:
    """M, N1 and N2 of two channels that have the same unstable poles, with M(∞) = 1."""
    poles = unstable(g1)
    denominator = ZeroPoleGain(poles, tuple(-p.conjugate() for p in poles), 1.0)
    return CoprimeFactors(denominator, (_with_mirrored_poles(g1), _with_mirrored_poles(g2)))


def unstable(g: ZeroPoleGain) -> Roots:
    """The poles of ``g`` in the closed right half plane."""
    return tuple(pole for pole in g.poles if pole.real >= 0)


def _with_mirrored_poles(g: ZeroPoleGain) -> ZeroPoleGain:
    return ZeroPoleGain(
        g.zeros, tuple(-p.conjugate() if p.real > 0 else p for p in g.poles), g.gain
    )


def with_poles_of(g: ZeroPoleGain, poles: Roots) -> ZeroPoleGain:
    """``g`` with each unstable pole that rounding alone tells from one of ``poles`` moved there."""
    moved = []
    for pole in g.poles:
        near = [p for p in poles if pole.real >= 0 and abs(p - pole) <= SAME_POLE * abs(pole)]
        moved.append(near[0] if near else pole)
    return ZeroPoleGain(g.zeros, tuple(moved), g.gain)
