"""The compensator F̂ of (2.37), (3.29): what channel 2 must add when channel 1 is lost.

G2 F̂ d̂ = G1 u1 (3.28) asks for 1/G2, but 1/G2 is improper, and unstable if G2 has zeros in the
right half plane; the outer factor and a low-pass filter (3.30) give G2 F̂ = q G2i, equal to 1 at s
= 0.
"""

from firmware_model.design.factorisation import inner_outer
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import ImproperError, require_order


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
