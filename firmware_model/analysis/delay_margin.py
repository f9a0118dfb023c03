"""The additional delay that a sampled loop survives, in whole ticks and to the very edge.

An extra delay of d ticks only turns L into z⁻ᵈL. Poles can reach the unit circle only where |L| = 1
and arg(-L) = dωT, so the least such d over all crossovers is a lower bound: below the bound the
Nyquist curve never meets -1. The curve for a fractional d is open at z = -1; with |L(-1)| < 1 the
gap adds no encirclement. Above the bound eigenvalues decide: whole ticks one by one, parts of a
tick by a command that changes within it.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np

from firmware_model.analysis.sampled_loop import SampledLoop

EXACT_DELAY_TICKS = 32  # up to here eigenvalues decide, above the crossovers of L do
PARTS_OF_A_TICK = 8
EDGE_TICKS = 1e-9  # so far on the stable side of the edge


def delay_margins(
    loop: SampledLoop, radius: Callable[[float], float]
) -> tuple[int | None, float | None]:
    """Extra delay that a stable ``loop`` survives: in whole ticks, and to the edge, in ticks.

    Args:
        loop: the loop without extra delay.
        radius: its spectral radius with so many ticks more.
    """
    bound = _least_critical_delay(loop)
    if math.isinf(bound):
        return None, None
    if bound > EXACT_DELAY_TICKS:  # slow crossovers: the hold's interpolation equals z⁻ᵈ
        return math.ceil(bound) - 1, bound
    start = max(math.ceil(bound) - 2, 0)
    whole = start
    while radius(whole + 1) < 1.0:
        whole += 1
    step = 1.0 / PARTS_OF_A_TICK
    survived = float(start)
    while radius(survived + step) < 1.0:
        survived += step
    beyond = survived + step
    edge = zero(lambda delay: math.log(radius(delay)), survived, beyond, EDGE_TICKS / 4.0)
    return whole, max(edge - EDGE_TICKS, 0.0)


def _least_critical_delay(loop: SampledLoop) -> float:
    """The least d > 0 for which 1 + e^{-jωdT} L(e^{jωT}) vanishes somewhere, in ticks."""
    angle = loop.angles
    size = np.abs(loop.loop_gain(np.exp(1j * angle)))
    if size[-1] >= 1.0:
        return 0.0  # every whole tick adds an encirclement at z = -1

    def log_size(theta: float) -> float:
        return math.log(abs(gain_at(loop, theta)))

    critical = math.inf
    for i in np.flatnonzero((size[:-1] > 1.0) != (size[1:] > 1.0)):
        theta = zero(log_size, float(angle[i]), float(angle[i + 1]))
        gain = gain_at(loop, theta)
        critical = min(critical, (cmath.phase(-gain) % (2.0 * math.pi)) / theta)
    return critical


def gain_at(loop: SampledLoop, theta: float) -> complex:
    """L(e^{jθ})."""
    return complex(loop.loop_gain(np.exp(1j * np.array([theta])))[0])


def zero(
    function: Callable[[float], float], low: float, high: float, tolerance: float = 0.0
) -> float:
    """Find the sign change of ``function`` between both ends by the Illinois method.

    The accuracy is the larger of ``tolerance`` and rounding.

    scipy.optimize has many such methods, but the import takes as long as all margins of a check.
    """
    at_low, at_high, middle = function(low), function(high), low
    for _ in range(100):  # it takes some ten
        middle = high - at_high * (high - low) / (at_high - at_low)
        value = function(middle)
        if value == 0.0 or abs(middle - high) <= max(4.0 * math.ulp(middle), tolerance):
            break
        if (value > 0.0) == (at_high > 0.0):
            at_low *= 0.5  # the other end stays for the second time: let the chord move
        else:
            low, at_low = high, at_high
        high, at_high = middle, value
    return middle
