"""A design specification, and the continuous design from specification and plant.

Chapter 3 closes the loop: u1 = C (r - y), u2 = F̂2 d̂. Chapter 2 leaves it open: u = r + F̂ d̂.
"""

from dataclasses import dataclass

from firmware_model.design.compensator import compensator
from firmware_model.design.estimator import FaultEstimator, fault_estimator
from firmware_model.design.factorisation import inner_outer
from firmware_model.design.factors.coprime import CoprimeFactors, unstable
from firmware_model.design.plants import Plant
from firmware_model.design.tracking import Tracking, tracking
from firmware_model.design.zpk import ZeroPoleGain, in_words
from firmware_model.errors import (
    UnstablePlantError,
    ZeroChannelError,
    require_order,
    require_positive,
)

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


def refuse_unreachable(plant: Plant, feedback: bool) -> None:
    """Raise unless C alone, and after the loss F̂ alone, can hold every unstable mode of ``plant``.

    A mode out of a channel's reach shows as a zero of the channel on the pole.
    """
    for label, channel in (("input 1", plant.g1), ("input 2", plant.g2)):
        for pole in unstable(channel):
            for zero in channel.zeros:
                if abs(zero - pole) <= REACH * abs(pole):
                    raise UnstablePlantError(
                        f"{plant.name}: {label} does not reach the unstable mode at "
                        f"{in_words(pole)}: must, or the mode cannot be held by that input alone"
                    )
            if not feedback:
                raise UnstablePlantError(
                    f"{plant.name}: pole at {in_words(pole)}, must have real part < 0 without "
                    "feedback"
                )
