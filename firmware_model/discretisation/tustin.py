"""From a continuous design to difference equations at a tick T.

Three rules; each rule works on poles and zeros in δ = z - 1, never on polynomials in z:

``tustin``       s = (2/T)(z-1)/(z+1): a root r moves to δ = rT/(1 - rT/2) and every zero at
                 infinity to δ = -2. Exact identity: H_d(e^{jωT}) = H_c(j(2/T)tan(ωT/2)).
``tustin_held``  Crank-Nicolson when the input is one value over the whole interval, as a command
                 on a bus is: x⁺ = (I - AT/2)⁻¹[(I + AT/2)x + BTu]. Worked out, that is Tustin
                 times 2/(z+1): one of the zeros at δ = -2 goes, and with it the feedthrough.
``zoh``          exact for a held input: x⁺ = e^{AT}x + ∫e^{At}dt Bu.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Final

import numpy as np

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.held_input import response, sampled, zeros_of
from firmware_model.discretisation.rules import Rule
from firmware_model.discretisation.sections import Sections, from_delta_zpk
from firmware_model.errors import ImproperError, ParameterError

DeltaRoots = tuple[list[complex], list[complex], float]
"""Zeros, poles and gain in δ."""


def tustin(g: ZeroPoleGain, tick_s: float, prewarp_rad_per_s: float | None = None) -> Sections:
    """The bilinear transform of ``g``.

    Args:
        g: proper transfer function.
        tick_s: sampling period T > 0, seconds.
        prewarp_rad_per_s: frequency at which the response is kept exactly, below π/T; without
            it that is zero frequency.

    Raises:
        ParameterError: a tick or a prewarp frequency out of range, a pole at 2/T.
        ImproperError: ``g`` has more zeros than poles.
    """
    return from_delta_zpk(*bilinear(g, tick_s, prewarp_rad_per_s), tick_s)


def zoh(g: ZeroPoleGain, tick_s: float) -> Sections:
    """The exact discretisation of ``g`` for an input held over each tick.

    Poles are e^{pT}. Zeros and gain come from the sampled state space: the gain from the
    feedthrough, or without feedthrough from the middle of the filter's band.

    Raises:
        ImproperError: ``g`` has more zeros than poles.
        ParameterError: a tick out of range.
    """
    return by_rule("zoh", g, tick_s)


def by_rule(rule: Rule, g: ZeroPoleGain, tick_s: float) -> Sections:
    """``g`` by ``rule``, its roots in δ paired into sections; raises what the rule raises."""
    return from_delta_zpk(*RULES[rule](g, tick_s), tick_s)


def _held_bilinear(g: ZeroPoleGain, tick_s: float) -> DeltaRoots:
    """Crank-Nicolson integration of ``g`` with one input value an interval.

    Raises:
        ImproperError: ``g`` has feedthrough, or more zeros than poles.
        ParameterError: as ``tustin``.
    """
    _check_tick(tick_s)
    if g.gain == 0.0:
        return [], [], 0.0
    if g.relative_degree < 1:
        raise ImproperError(
            f"tustin-held needs more poles than zeros (got {len(g.poles)} and {len(g.zeros)}): "
            "it filters the input by 2/(z + 1), a feedthrough path too; use zoh or tustin"
        )
    zeros, poles, gain = bilinear(g, tick_s, None)
    zeros.remove(-2.0)
    return zeros, poles, 2.0 * gain


@lru_cache(maxsize=64)  # a search designs hundreds of controllers for one plant
def _held_exactly(g: ZeroPoleGain, tick_s: float) -> DeltaRoots:
    """``zoh`` as zeros, poles and gain in δ; the lists are never changed."""
    _check_tick(tick_s)
    _require_proper(g)
    g = g.cancelled()  # so the state space has a state for each remaining pole
    if not g.poles:
        return [], [], g.gain
    poles = np.array([_expm1(p * tick_s) for p in g.poles])
    system = sampled(g, tick_s)
    zeros = zeros_of(system, g.feedthrough, poles)
    if g.feedthrough:
        return zeros, [complex(pole) for pole in poles], g.feedthrough
    middle = np.abs(poles[poles != 0.0])
    probe = float(np.exp(np.log(middle).mean())) if middle.size else 1.0
    if (poles.real > 0.0).any():
        probe = 2.0 * float(middle.max())  # right of all poles
    scale = np.prod([probe - p for p in poles]) / np.prod([probe - q for q in zeros])
    gain = (response(system, np.array([probe], np.complex128)).item() * scale).real
    return zeros, [complex(pole) for pole in poles], float(gain)


def bilinear(g: ZeroPoleGain, tick_s: float, prewarp_rad_per_s: float | None) -> DeltaRoots:
    """Zeros, poles and gain in δ: s = κ(z-1)/(z+1) gives δ = 2r/(κ - r) for a root r."""
    _check_tick(tick_s)
    _require_proper(g)
    kappa = image_of_infinity(tick_s, prewarp_rad_per_s)
    for pole in g.poles:
        if pole == kappa:
            raise ParameterError(f"a pole at {pole.real:g} rad/s is mapped to infinity; change T")
    zeros = [2.0 * r / (kappa - r) for r in g.zeros if r != kappa]  # a zero at κ goes to infinity
    zeros += [complex(-2.0)] * g.relative_degree
    poles = [2.0 * r / (kappa - r) for r in g.poles]
    # In pairs: products of many large factors would overflow or lose digits.
    factors = [kappa - r if r != kappa else complex(-2.0 * kappa) for r in g.zeros]
    factors += [complex(1.0)] * g.relative_degree
    gain = complex(g.gain)
    for above, below in zip(factors, [kappa - r for r in g.poles], strict=True):
        gain *= above / below
    return zeros, poles, gain.real


def image_of_infinity(tick_s: float, prewarp_rad_per_s: float | None) -> float:
    """2/T, or with prewarp ω/tan(ωT/2)."""
    if prewarp_rad_per_s is None:
        return 2.0 / tick_s
    if not 0.0 < prewarp_rad_per_s < math.pi / tick_s:
        raise ParameterError(
            f"prewarp_rad_per_s = {prewarp_rad_per_s:g}: must be above 0 and below the Nyquist "
            f"frequency, {math.pi / tick_s:g} rad/s"
        )
    return prewarp_rad_per_s / math.tan(prewarp_rad_per_s * tick_s / 2.0)


def _check_tick(tick_s: float) -> None:
    if not (math.isfinite(tick_s) and tick_s > 0.0):
        raise ParameterError(f"tick_s = {tick_s:g}: must be finite and above 0 s")


def _require_proper(g: ZeroPoleGain) -> None:
    if not g.is_proper:
        raise ImproperError(
            f"a transfer function with {len(g.zeros)} zeros and {len(g.poles)} poles is improper: "
            "must have at least as many poles as zeros"
        )


def _expm1(x: complex) -> complex:
    """e^x - 1 to full relative precision for small complex x (Python's expm1 takes reals)."""
    if x.real > 700.0:
        raise ParameterError(
            f"an unstable pole times the tick is {x.real:.3g}: must be at most 700"
        )
    if x.real < -1400.0:  # beyond the range of sinh
        return complex(-1.0)
    half = cmath.exp(x / 2.0)
    return 2.0 * half * cmath.sinh(x / 2.0)


RULES: Final[Mapping[Rule, Callable[[ZeroPoleGain, float], DeltaRoots]]] = {
    "tustin": lambda g, tick_s: bilinear(g, tick_s, None),
    "tustin-held": _held_bilinear,
    "zoh": _held_exactly,
}
"""Zeros, poles and gain in δ by each rule."""
