"""The tracking controller C of (3.32)-(3.34), multiplied out by hand to its minimal order.

With G1 = N1/D and Q = q̂/G1, (3.32) is C = q̂/(G1 (1 - q̂)), and with q̂ = 1/(1 + τq s)^αq

    C = D / (N1 ((1 + τq s)^αq - 1)).

The last factor vanishes where 1 + τq s is an αq-th root of one: s = (exp(2πik/αq) - 1)/τq. The
root k = 0 is s = 0 exactly, the integrator that leaves a step no steady-state error.
"""

import math

from firmware_model.design.factorisation import refuse_unfactorable
from firmware_model.design.zpk import Roots, ZeroPoleGain
from firmware_model.errors import (
    ImproperError,
    NonMinimumPhaseError,
    require_order,
    require_positive,
)


def tracking(g1: ZeroPoleGain, tau_q_s: float, alpha_q: int) -> ZeroPoleGain:
    """C of (3.32), order ``len(g1.zeros) + alpha_q``; input r - y, output u1 [N m for the car].

    Raises ``ParameterError`` unless τq is finite and > 0 and αq an integer >= 1; for ``g1``
    ``ZeroChannelError``, ``UnstablePlantError``, ``AxisZeroError``, ``NonMinimumPhaseError`` (Q
    would be unstable); ``ImproperError`` naming the least αq when Q = q̂/G1 is improper.
    """
    require_positive("tau_q_s", tau_q_s)
    require_order("alpha_q", alpha_q)
    refuse_unfactorable(g1, "G1")
    for zero in g1.zeros:
        if zero.real > 0:
            raise NonMinimumPhaseError(
                f"G1 has a zero at {zero:.6g} rad/s: must have real part < 0 for Q = q̂/G1 in RH∞"
            )
    if alpha_q < g1.relative_degree:
        raise ImproperError(
            f"alpha_q = {alpha_q}: q̂/G1 is improper, alpha_q must be at least {g1.relative_degree}"
        )
    lag = ZeroPoleGain.lag(tau_q_s, alpha_q)
    return ZeroPoleGain(
        zeros=g1.poles,
        poles=(*g1.zeros, *(root / tau_q_s for root in roots_of_one_less_one(alpha_q))),
        gain=lag.gain / g1.gain,
    )


def tracking_filter(g1: ZeroPoleGain, tau_q_s: float, alpha_q: int) -> ZeroPoleGain:
    """Q = q̂/G1 of (3.33), from which C = Q/(1 - Q G1) (3.32); raises what ``tracking`` raises."""
    tracking(g1, tau_q_s, alpha_q)  # refuses what has no Q
    lag = ZeroPoleGain.lag(tau_q_s, alpha_q)
    return ZeroPoleGain(g1.poles, (*g1.zeros, *lag.poles), lag.gain / g1.gain)


def roots_of_one_less_one(order: int) -> Roots:
    """``exp(2πik/order) - 1`` for k = 0..order-1; real ones and conjugate pairs are exactly so."""
    real: Roots = (0j,) if order % 2 else (0j, -2 + 0j)
    # exp(iθ) - 1 = -2 sin²(θ/2) + i sin θ, which does not subtract near-equal numbers
    angles = [2 * math.pi * k / order for k in range(1, (order + 1) // 2)]
    upper = [complex(-2 * math.sin(theta / 2) ** 2, math.sin(theta)) for theta in angles]
    return (*real, *upper, *(root.conjugate() for root in upper))
