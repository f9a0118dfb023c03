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

The module also has transfer functions as state spaces, with the unstable poles apart.

The complementary sensitivity T = q̂ G1i P of any plant, stable and minimum phase or not.

For internal stability T must vanish at the zeros of G1 in the right half plane (the inner factor
G1i ensures so), and be 1 at every unstable pole p (Zames and Francis, IEEE Trans. Automat. Contr.
28 (1983) 585), as it is at s = 0 to track a step. For k such poles,

    P = (1 + c1 s + ... + ck s^k)/(1 + τq s)^k

has as many coefficients. The coefficients make the numerator of 1 - T a multiple of s Π(s - p): a
linear system, also for repeated poles. All polynomials are in x = τq s.

The limits set by zeros and poles in the right half plane for every controller.

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

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_model.design.zpk import Roots, ZeroPoleGain
from firmware_model.errors import ParameterError

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


Polynomial = NDArray[np.float64]


def congruent(
    factor: Polynomial, wanted: Polynomial, modulus: Polynomial
) -> tuple[Polynomial, Polynomial]:
    """x of degree below that of ``modulus``, and a quotient: factor x + modulus quotient = wanted.

    ``modulus`` is monic and has no root in common with ``factor``. A linear system: each power of s
    times ``factor`` leaves a remainder, and the remainders must add up to the remainder of
    ``wanted``.
    """
    size = len(modulus) - 1
    if size == 0:
        return np.zeros(1), wanted
    powers = [np.eye(1, i + 1)[0] for i in reversed(range(size))]
    columns = [_remainder(np.convolve(factor, power), modulus) for power in powers]
    x = np.linalg.solve(np.array(columns).T, _remainder(wanted, modulus)).astype(np.float64)
    quotient, _ = np.polydiv(np.polysub(wanted, np.convolve(factor, x)), modulus)
    return x, np.asarray(quotient, dtype=np.float64)


def monic(roots: tuple[complex, ...]) -> Polynomial:
    """Π (s - root)."""
    return np.atleast_1d(np.poly(roots).real).astype(np.float64)


def _remainder(polynomial: Polynomial, modulus: Polynomial) -> Polynomial:
    """Remainder of the division by ``modulus``: one coefficient for each root of ``modulus``."""
    _, rest = np.polydiv(polynomial, modulus)
    size = len(modulus) - 1
    return np.concatenate([np.zeros(max(size - len(rest), 0)), rest])[-size:]


Matrix = NDArray[np.float64]
Realisation = tuple[Matrix, Matrix, Matrix, float]


@dataclass(frozen=True)
class Parts:
    """A transfer function as residues/Π(s - p) + ``stable``, over its unstable poles p.

    ``residues`` (k,) are the coefficients of a polynomial, highest power first.
    """

    residues: Matrix
    stable: ZeroPoleGain


def in_parts(g: ZeroPoleGain, name: str) -> Parts:
    """The partial fractions of ``g``; zero and ``g`` for a stable ``g``.

    Raises:
        ParameterError: ``g`` needs fewer zeros than poles; the message calls ``g`` ``name``.
    """
    if g.gain != 0.0 and g.relative_degree < 1:
        raise ParameterError(
            f"{name} has {len(g.zeros)} zeros and {g.order} poles: must have fewer zeros than "
            "poles, as a plant that its input reaches only through states"
        )
    poles = unstable(g)
    if not poles:
        return Parts(np.zeros(0), g)
    rest = tuple(pole for pole in g.poles if pole.real < 0)
    residues, numerator = congruent(monic(rest), g.numerator(), monic(poles))
    zeros = ZeroPoleGain.from_coefficients(numerator, [1.0])
    return Parts(residues, ZeroPoleGain(zeros.zeros, rest, zeros.gain))


def companion(poles: Roots) -> Matrix:
    """A (k, k) whose first state is n/Π(s - p) u, with n the coefficients of b, (k,)."""
    a = np.eye(len(poles), k=1)
    a[:, :1] -= monic(poles)[1:, np.newaxis]
    return a


def realised(g: ZeroPoleGain) -> Realisation:
    """A (n, n), b (n,), c (n,) and d with ``g`` = c (sI - A)⁻¹ b + d, n its poles; g is proper.

    One companion form would hold the coefficients of a polynomial of high order and lose digits;
    each section of a chain holds the coefficients of two roots:

        x1' = x2,  x2' = -a0 x1 - a1 x2 + u,  y = c0 x1 + c1 x2 + d u
    """
    numerators, denominators = _sections(g.zeros), _sections(g.poles)
    numerators += [np.ones(1)] * (len(denominators) - len(numerators))
    a, b, c, feedthrough = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    for num, den in zip(numerators, denominators, strict=True):
        order, before = len(den) - 1, len(a)
        padded = np.concatenate([num, np.zeros(order + 1 - len(num))])
        own_b, own_d = np.eye(order)[-1], float(padded[-1])
        own_c = padded[:-1] - own_d * den[:-1]
        own_a = np.eye(order, k=1)
        own_a[-1] -= den[:-1]
        a = np.block([[a, np.zeros((before, order))], [np.outer(own_b, c), own_a]])
        b = np.concatenate([b, feedthrough * own_b])
        c = np.concatenate([own_d * c, own_c])
        feedthrough *= own_d
    return a, b, g.gain * c, g.gain * feedthrough


def _sections(roots: Sequence[complex]) -> list[Matrix]:
    """Monic polynomials of the roots in pairs, lowest power first; the last may have one root.

    ``roots`` are in the order of ``ZeroPoleGain``: real roots come first.
    """
    real = [root.real for root in roots if root.imag == 0]
    pairs = [np.array([abs(root) ** 2, -2.0 * root.real, 1.0]) for root in roots if root.imag > 0]
    twos = [np.array([r * q, -(r + q), 1.0]) for r, q in zip(real[::2], real[1::2], strict=False)]
    last = [np.array([-real[-1], 1.0])] if len(real) % 2 else []
    return [*twos, *pairs, *last]


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
