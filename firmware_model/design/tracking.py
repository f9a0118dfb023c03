"""The tracking controller C of (3.32)-(3.34), for any plant with no zero on the imaginary axis.

The thesis treats a stable, minimum-phase G1: Q = q̂/G1 makes the healthy loop T = q̂, and C runs as
u1 = Q (r - y + G1 u1). For any other G1 = N1/M of ``coprime``, with N1 = N1i N1o in inner and outer
factors, all stabilising controllers are C = U/V with U N1 + V M = 1 in RH∞ (Youla).
``interpolation`` chooses T, and T fixes U and V:

    T = q̂ N1i P,   U = T/N1 = q̂ P/N1o,   V = (1 - T)/M

and V u1 = U (r - y) is, with only stable filters,

    u1 = U (r - y + N1 u1) + R u1,   R = 1 - U N1 - V = (1 - 1/M)(1 - T)

hence the thesis's structure plus a filter R, strictly proper and zero for a stable plant. C itself,
multiplied out: with S the zeros of 1 - T other than s = 0 and the unstable poles,

    C = P's numerator · G1's stable poles / (G1's zeros in the left half plane · s · S)

s = 0 is the integrator: a step leaves no steady-state error.
"""

from dataclasses import dataclass

import numpy as np

from firmware_model.design.factorisation import inner_outer, refuse_axis_zeros
from firmware_model.design.factors.coprime import left_coprime, unstable
from firmware_model.design.factors.interpolation import Interpolation, interpolate
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import ImproperError, require_order, require_positive


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
    refuse_axis_zeros(g1, "G1")
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
    inner: ZeroPoleGain,
    found: Interpolation,
    lags: tuple[complex, ...],
    m: ZeroPoleGain,
) -> ZeroPoleGain:
    """R: of Π(s - p) - Π(s - p*) the powers of s that both have, the highest, cancel."""
    difference = (np.poly(m.zeros) - np.poly(m.poles)).real[1:]
    return ZeroPoleGain(
        zeros=(*(complex(root) for root in np.roots(difference)), 0j, *found.remaining),
        poles=(*inner.poles, *lags),
        gain=float(difference[0]),
    )
