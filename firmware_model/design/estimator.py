"""The fault estimator d̂ = F1 u + F2 y of (2.1): Theorems 2.3.1 and 2.3.2.

Silent while the plant is healthy means (F1 + F2 G) u = 0 for every u (2.19), so F1 = -F2 G (2.20),
and every such pair in RH∞ is F2 = -(1 + Q), F1 = (1 + Q) [G1 G2] for some Q in RH∞ (2.10), (2.11).
With the left-coprime factors of a plant that is not stable, G = M⁻¹ [N1 N2], that is (1 + Q) M in
place of 1 + Q: F2 = -(1 + Q) M, F1 = (1 + Q) [N1 N2], and d̂ = N1 u1 after the loss.
"""

from dataclasses import dataclass

import numpy as np

from firmware_model.design.factors.coprime import CoprimeFactors
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import ImproperError, UnstableFilterError

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
