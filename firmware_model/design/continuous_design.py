"""A design specification, and the continuous design from specification and plant.

Chapter 3 closes the loop: u1 = C (r - y), u2 = F̂2 d̂. Chapter 2 leaves it open: u = r + F̂ d̂.

Inner-outer factorisation of a stable channel: G = Gi·Go with Gi(0) = 1, (3.31).

A zero z in the right half plane has no stable inverse. The mirror image -conj(z) has a stable
inverse, and

    (s - z) = (z - s)/(conj(z) + s) · (-1)(s + conj(z))

moves the difference into an all-pass factor; over a conjugate pair that factor is real, and is 1
at s = 0.

The tracking controller C of (3.32)-(3.34), for any plant with no zero on the imaginary axis.

The thesis treats a stable, minimum-phase G1: Q = q̂/G1 makes the healthy loop T = q̂, and C runs as
u1 = Q (r - y + G1 u1). For any other G1 = N1/M of ``factors``, with N1 = N1i N1o in inner and outer
factors, all stabilising controllers are C = U/V with U N1 + V M = 1 in RH∞ (Youla).
``factors.interpolation`` chooses T, and T fixes U and V:

    T = q̂ N1i P,   U = T/N1 = q̂ P/N1o,   V = (1 - T)/M

and V u1 = U (r - y) is, with only stable filters,

    u1 = U (r - y + N1 u1) + R u1,   R = 1 - U N1 - V = (1 - 1/M)(1 - T)

hence the thesis's structure plus a filter R, strictly proper and zero for a stable plant. C itself,
multiplied out: with S the zeros of 1 - T other than s = 0 and the unstable poles,

    C = P's numerator · G1's stable poles / (G1's zeros in the left half plane · s · S)

s = 0 is the integrator: a step leaves no steady-state error.

The fault estimator d̂ = F1 u + F2 y of (2.1): Theorems 2.3.1 and 2.3.2.

Silent while the plant is healthy means (F1 + F2 G) u = 0 for every u (2.19), so F1 = -F2 G (2.20),
and every such pair in RH∞ is F2 = -(1 + Q), F1 = (1 + Q) [G1 G2] for some Q in RH∞ (2.10), (2.11).
With the left-coprime factors of a plant that is not stable, G = M⁻¹ [N1 N2], that is (1 + Q) M in
place of 1 + Q: F2 = -(1 + Q) M, F1 = (1 + Q) [N1 N2], and d̂ = N1 u1 after the loss.

The compensator F̂ of (2.37), (3.29): what channel 2 must add when channel 1 is lost.

G2 F̂ d̂ = G1 u1 (3.28) asks for 1/G2, but 1/G2 is improper, and unstable if G2 has zeros in the
right half plane; the outer factor and a low-pass filter (3.30) give G2 F̂ = q G2i, equal to 1 at s
= 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from firmware_model.design.factors import (
    CoprimeFactors,
    Interpolation,
    interpolate,
    left_coprime,
    unstable,
)
from firmware_model.design.plants import Plant
from firmware_model.design.zpk import ZeroPoleGain, in_words
from firmware_model.errors import (
    AxisZeroError,
    ImproperError,
    UnstableFilterError,
    UnstablePlantError,
    ZeroChannelError,
    require_order,
    require_positive,
)

AXIS_TOLERANCE = 1e-6
"""Least damping ratio |Re z|/|z| of a zero. 1/Go rings with the damping of G's zeros; below 1e-6 it
is a resonator for thousands of seconds, and a double zero on the axis, which rounding splits by
√eps ≈ 1.5e-8, still counts as on it."""


def inner_outer(g: ZeroPoleGain, name: str = "G") -> tuple[ZeroPoleGain, ZeroPoleGain]:
    """``(inner, outer)``: inner all-pass with inner(0) = 1, outer stable and minimum phase.

    Without zeros in the right half plane the inner factor is the constant 1 and ``outer`` is ``g``.
    ``name`` is what messages call ``g``.

    Raises ``ZeroChannelError`` for g = 0, ``UnstablePlantError`` for a pole that is not in the left
    half plane, ``AxisZeroError`` for a zero on or near the imaginary axis, s = 0 included.
    """
    if g.gain == 0:
        raise ZeroChannelError(f"{name}(s) is identically zero, must not be")
    for zero in g.zeros:
        if abs(zero.real) <= AXIS_TOLERANCE * abs(zero):
            raise AxisZeroError(
                f"{name} has a zero at {zero:.6g} rad/s, on the imaginary axis within a damping"
                f" ratio of {AXIS_TOLERANCE:g}: must be clear of it"
            )
    for pole in g.poles:
        if pole.real >= 0:
            raise UnstablePlantError(
                f"{name} has a pole at {pole:.6g} rad/s, must have real part < 0"
            )
    mirrored = [z for z in g.zeros if z.real > 0]
    kept = [z for z in g.zeros if z.real < 0]
    images = [-z.conjugate() for z in mirrored]
    sign = (-1.0) ** len(mirrored)
    inner = ZeroPoleGain(tuple(mirrored), tuple(images), sign)
    outer = ZeroPoleGain((*kept, *images), g.poles, sign * g.gain)
    return inner, outer


@dataclass(frozen=True)
class Tracking:
    """``controller`` is C from r - y to u1; the target runs ``filter`` U and ``stabiliser`` R.

    ``complementary`` is T, from r to y in the healthy loop. For a stable G1 ``stabiliser`` is None
    and ``filter`` is the thesis's Q.
    """

    controller: ZeroPoleGain
    filter: ZeroPoleGain
    stabiliser: ZeroPoleGain | None
    complementary: ZeroPoleGain


def tracking(g1: ZeroPoleGain, tau_q_s: float, alpha_q: int) -> Tracking:
    """C of ``g1`` with q̂ = 1/(1 + τq s)^αq, τq in seconds; for the car u1 is in N m.

    Raises ``ParameterError`` unless τq is finite and > 0 and αq an integer >= 1; for ``g1``
    ``ZeroChannelError`` and ``AxisZeroError``; ``ImproperError`` naming the least αq when U is
    improper.
    """
    require_positive("tau_q_s", tau_q_s)
    require_order("alpha_q", alpha_q)
    if alpha_q < g1.relative_degree:
        raise ImproperError(
            f"alpha_q = {alpha_q}: q̂/G1 is improper, alpha_q must be at least {g1.relative_degree}"
        )
    poles = unstable(g1)
    zeros = tuple(zero for zero in g1.zeros if zero.real > 0)
    factors = left_coprime(g1, g1, tau_q_s)
    inner, outer = inner_outer(factors.numerators[0], name="G1")
    found = interpolate(zeros, poles, tau_q_s, alpha_q)
    lag = ZeroPoleGain.lag(tau_q_s, alpha_q)
    lags = (*lag.poles, *lag.poles[:1] * len(poles))
    gain = found.gain * lag.gain
    return Tracking(
        controller=ZeroPoleGain(
            zeros=(*found.zeros, *(pole for pole in g1.poles if pole.real < 0)),
            poles=(*(zero for zero in g1.zeros if zero.real < 0), 0j, *found.remaining),
            gain=gain / outer.gain,
        ),
        filter=ZeroPoleGain((*found.zeros, *outer.poles), (*outer.zeros, *lags), gain / outer.gain),
        stabiliser=_stabiliser(inner, found, lags, factors.denominator) if poles else None,
        complementary=inner * ZeroPoleGain(found.zeros, lags, gain),
    )


def _stabiliser(
    inner: ZeroPoleGain, found: Interpolation, lags: tuple[complex, ...], m: ZeroPoleGain
) -> ZeroPoleGain:
    """R: of Π(s - p) - Π(s - p*) the powers of s that both have, the highest, cancel."""
    difference = (np.poly(m.zeros) - np.poly(m.poles)).real[1:]
    return ZeroPoleGain(
        zeros=(*(complex(root) for root in np.roots(difference)), 0j, *found.remaining),
        poles=(*inner.poles, *lags),
        gain=float(difference[0]),
    )


_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class FaultEstimator:
    """``f1`` (one for each input) and ``f2`` of (2.1), in the plant's units of output an input.

    ``one_plus_q`` is the common factor: the target runs d̂ = (1 + Q)(N1 u1 + N2 u2 - M y), so the
    shared filter has a single copy.
    """

    f1: tuple[ZeroPoleGain, ZeroPoleGain]
    f2: ZeroPoleGain
    one_plus_q: ZeroPoleGain


def fault_estimator(factors: CoprimeFactors, q: ZeroPoleGain | None = None) -> FaultEstimator:
    """Theorem 2.3.1 for ``q``; ``None`` is Theorem 2.3.2, where d̂ = N1 u1 after the loss (2.9).

    ``factors`` are the plant's.

    Raises ``UnstableFilterError`` or ``ImproperError`` for a ``q`` outside RH∞.
    """
    one_plus_q = ZeroPoleGain.constant(1.0) if q is None else _one_plus(q)
    n1, n2 = factors.numerators
    return FaultEstimator(
        f1=(one_plus_q * n1, one_plus_q * n2),
        f2=(one_plus_q * factors.denominator).scaled(-1.0),
        one_plus_q=one_plus_q,
    )


def _one_plus(q: ZeroPoleGain) -> ZeroPoleGain:
    """1 + N/D = (D + N)/D; a sum within rounding of zero becomes zero, not a far zero."""
    if not q.is_stable():
        pole = max(q.poles, key=lambda p: p.real)
        raise UnstableFilterError(f"Q has a pole at {pole:.6g} rad/s, must have real part < 0")
    if not q.is_proper:
        raise ImproperError(
            f"Q has {len(q.zeros)} zeros and {len(q.poles)} poles, must have no more zeros"
        )
    den = q.denominator()
    num = np.concatenate([np.zeros(q.relative_degree), q.numerator()])
    rounding = (q.order + 2) * _EPS * (np.abs(den) + np.abs(num))
    total = np.where(np.abs(den + num) <= rounding, 0.0, den + num)
    zeros = ZeroPoleGain.from_coefficients(total, [1.0])
    return ZeroPoleGain(zeros.zeros, q.poles, zeros.gain)


def compensator(g2: ZeroPoleGain, tau_s: float, alpha: int) -> ZeroPoleGain:
    """F̂2 = q/G2o with q = 1/(1 + τs)^α, τ in seconds; input d̂, output u2 [N for the car].

    Raises ``ParameterError`` unless τ is finite and > 0 and α an integer >= 1, ``ImproperError``
    naming the least α for an α too small, and the errors of ``inner_outer`` for ``g2``.
    """
    require_order("alpha", alpha)
    _, outer = inner_outer(g2)
    if alpha < outer.relative_degree:
        raise ImproperError(
            f"alpha = {alpha}: q/G2o is improper, alpha must be at least {outer.relative_degree}"
        )
    return ZeroPoleGain.lag(tau_s, alpha) * outer.inverse()


REACH = 1e-6
"""Least distance of a zero from an unstable pole, over the size of that: the sensitivity is at
least twice its inverse."""


@dataclass(frozen=True)
class DesignSpecification:
    """What the designer chooses; the defaults are the published tuning (3.37), (3.39).

    ``tau_s`` [s] and ``alpha`` shape q of (3.30); ``tau_q_s`` [s] and ``alpha_q`` shape q̂ of
    (3.34); ``q`` is the free parameter of Theorem 2.3.1, ``None`` for Theorem 2.3.2. Without
    ``compensation`` there is no F̂; without ``feedback`` no C: chapter 2's open loop.

    Raises ``ParameterError`` unless both time constants are finite and > 0 and both orders
    integers >= 1.
    """

    tau_s: float = 0.001
    alpha: int = 1
    tau_q_s: float = 0.001
    alpha_q: int = 2
    q: ZeroPoleGain | None = None
    compensation: bool = True
    feedback: bool = True

    def __post_init__(self) -> None:
        require_positive("tau_s", self.tau_s)
        require_order("alpha", self.alpha)
        require_positive("tau_q_s", self.tau_q_s)
        require_order("alpha_q", self.alpha_q)


@dataclass(frozen=True)
class ContinuousDesign:
    """The controllers of Figs. 2.1 and 3.4 and the factors of G2; ``None`` if not requested.

    ``factors`` are M, N1 and N2 of the plant, 1, G1 and G2 of a stable one. ``compensator`` is F̂2
    from d̂ to u2, ``tracking`` is C from r - y to u1 with the parts of C; ``inner`` and ``outer``
    are G2i and G2o of (3.31), for an unstable plant the factors of N2.
    """

    plant: Plant
    specification: DesignSpecification
    factors: CoprimeFactors
    estimator: FaultEstimator
    compensator: ZeroPoleGain | None
    tracking: Tracking | None
    inner: ZeroPoleGain
    outer: ZeroPoleGain


def design(plant: Plant, specification: DesignSpecification) -> ContinuousDesign:
    """Everything that runs, still continuous; every assumption of the thesis is checked on the way.

    | assumption | where | refused with |
    |---|---|---|
    | G1 ≠ 0, G2 ≠ 0 | (2.3) | ``Plant`` cannot be made otherwise |
    | each channel reaches every unstable mode; feedback | (3.17) | ``UnstablePlantError`` |
    | Q in RH∞ | Theorem 2.3.1 | ``UnstableFilterError``, ``ImproperError`` |
    | 1 + Q ≠ 0, or F̂ has nothing to act on | (2.35) | ``ZeroChannelError`` |
    | G2 has no zero on the imaginary axis | (3.31) | ``AxisZeroError`` |
    | q/G2o is proper | (3.29) | ``ImproperError`` |
    | G1 has no zero on the imaginary axis | (3.32) | ``AxisZeroError`` |
    | q̂/G1 is proper | (3.33) | ``ImproperError`` |
    """
    refuse_unreachable(plant, specification.feedback)
    factors = plant.coprime(specification.tau_q_s)
    estimator = fault_estimator(factors, specification.q)
    if specification.compensation and estimator.one_plus_q.gain == 0:
        raise ZeroChannelError(
            "q = -1: the fault estimate is identically zero; compensation must have Q other than -1"
        )
    _, n2 = factors.numerators
    inner, outer = inner_outer(n2)
    return ContinuousDesign(
        plant=plant,
        specification=specification,
        factors=factors,
        estimator=estimator,
        compensator=(
            compensator(n2, specification.tau_s, specification.alpha)
            if specification.compensation
            else None
        ),
        tracking=(
            tracking(plant.g1, specification.tau_q_s, specification.alpha_q)
            if specification.feedback
            else None
        ),
        inner=inner,
        outer=outer,
    )


def _cancels(channel: ZeroPoleGain, pole: complex) -> bool:
    """Whether a zero of the channel stands on the pole."""
    return any(abs(zero - pole) <= REACH * abs(pole) for zero in channel.zeros)


def refuse_unreachable(plant: Plant, feedback: bool) -> None:
    """Raise unless C alone, and after the loss F̂ alone, can hold every unstable mode of ``plant``.

    A mode out of a channel's reach shows as a zero of the channel on the pole, a mode that the
    output does not show as such a zero of both channels.
    """
    for label, channel in (("input 1", plant.g1), ("input 2", plant.g2)):
        for pole in unstable(channel):
            if all(_cancels(each, pole) for each in (plant.g1, plant.g2)):
                raise UnstablePlantError(
                    f"{plant.name}: no input moves the output through the unstable mode at "
                    f"{in_words(pole)}: must, or no controller holds the mode"
                )
            if _cancels(channel, pole):
                raise UnstablePlantError(
                    f"{plant.name}: {label} does not reach the unstable mode at "
                    f"{in_words(pole)}: must, or the mode cannot be held by that input alone"
                )
            if not feedback:
                raise UnstablePlantError(
                    f"{plant.name}: pole at {in_words(pole)}, must have real part < 0 without "
                    "feedback"
                )
