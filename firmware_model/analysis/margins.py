"""Stability margins of the sampled loop, and the gain from measurement noise.

``SampledLoop``, the target's loop opened at the measurement, gives all figures. One figure is the
additional delay that a sampled loop survives, in whole ticks and to the very edge.

An extra delay of d ticks only turns L into z⁻ᵈL. Poles can reach the unit circle only where |L| = 1
and arg(-L) = dωT, so the least such d over all crossovers is a lower bound: below the bound the
Nyquist curve never meets -1. The curve for a fractional d is open at z = -1; with |L(-1)| < 1 the
gap adds no encirclement. Above the bound eigenvalues decide: whole ticks one by one, parts of a
tick by a command that changes within it.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from firmware_model.analysis.sampled_loop import (
    LinearController,
    SampledLoop,
    integrators,
    linear_controller,
    sampled_loop,
)
from firmware_model.design.continuous_design import ContinuousDesign
from firmware_model.design.plants import Plant
from firmware_model.discretisation.sections import energy_of, reaching
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.errors import DesignError
from firmware_model.law.layout import Table
from firmware_model.law.structs import MAX_LATENCY_TICKS, FloatArray

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
        return math.log(abs(loop.gain_at(theta)))

    critical = math.inf
    for i in np.flatnonzero((size[:-1] > 1.0) != (size[1:] > 1.0)):
        theta = zero(log_size, float(angle[i]), float(angle[i + 1]))
        gain = loop.gain_at(theta)
        critical = min(critical, (cmath.phase(-gain) % (2.0 * math.pi)) / theta)
    return critical


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


HEALTHY = (1.0, 1.0)
TORQUE_DEAD = (0.0, 1.0)  # the thesis's fault

MOST_GAIN = 1e3
SEEN = 0.05  # of |L| at a hundredth of the slowest pole, an imaginary part that an integrator has


@dataclass(frozen=True)
class Margins:
    """Figures of merit of a loop. Figures undefined for an unstable loop are ``None`` or NaN.

    Attributes:
        spectral_radius: largest magnitude of a pole, per tick; below 1 is stable.
        slowest_rad_per_s: |s| of the pole z = e^{sT} with the largest magnitude.
        slowest_damping: -Re(s)/|s| of the same pole; 1 without oscillation, below 0 unstable.
        delay_margin_ticks: whole extra ticks of delay, unknown to the controller, up to which the
            loop is stable; None without limit.
        delay_margin_s: the extra delay at the edge of stability, seconds.
        gain_margin: smallest factor above 1 on the measurement that makes the loop unstable.
        gain_reduction_margin: largest such factor below 1; 0 without limit.
        peak_sensitivity: max |S(e^{jωT})|, S = 1/(1 + L).
        peak_sensitivity_rad_per_s: where.
        noise_to_command_1, noise_to_command_2: rms of a command for white measurement noise of rms
            1; infinite with an open integrator.
    """

    spectral_radius: float
    slowest_rad_per_s: float
    slowest_damping: float
    delay_margin_ticks: int | None = None
    delay_margin_s: float | None = None
    gain_margin: float = math.nan
    gain_reduction_margin: float = math.nan
    peak_sensitivity: float = math.nan
    peak_sensitivity_rad_per_s: float = math.nan
    noise_to_command_1: float = math.inf
    noise_to_command_2: float = math.inf

    @property
    def stable(self) -> bool:
        """Every pole inside the unit circle."""
        return self.spectral_radius < 1.0


def margins(
    table: Table,
    plant: Plant,
    tick_s: float,
    effectiveness: tuple[float, float] = HEALTHY,
    confirmed: float | None = None,
) -> Margins:
    """The margins of ``table`` around ``plant`` at the ``effectiveness`` of the actuators.

    Arguments and errors as in ``sampled_loop``; ``confirmed`` as in ``linear_controller``, by
    default whenever an actuator is not whole.
    """
    law = law_in(table, effectiveness) if confirmed is None else linear_controller(table, confirmed)
    return margins_of(law, plant, tick_s, effectiveness)


def margins_of(
    law: LinearController, plant: Plant, tick_s: float, effectiveness: tuple[float, float] = HEALTHY
) -> Margins:
    """The margins of a linear controller around ``plant``; see ``margins``."""
    loop = sampled_loop(law, plant, tick_s, effectiveness)
    poles = loop.poles()
    slowest = complex(poles[np.argmax(np.abs(poles))])
    exponent = cmath.log(slowest) / tick_s
    figures = Margins(
        spectral_radius=abs(slowest),
        slowest_rad_per_s=abs(exponent),
        slowest_damping=-math.cos(cmath.phase(exponent)),
    )
    if not figures.stable:
        return figures

    def delayed_radius(delay_ticks: float) -> float:
        late = sampled_loop(law, plant, tick_s, effectiveness, delay_ticks)
        return late.spectral_radius()

    whole, ticks = delay_margins(loop, delayed_radius)
    reduction, increase = gain_margins(loop)
    peak, at_rad_per_s = peak_sensitivity(loop)
    return replace(
        figures,
        delay_margin_ticks=whole,
        delay_margin_s=None if ticks is None else ticks * tick_s,
        gain_margin=increase,
        gain_reduction_margin=reduction,
        peak_sensitivity=peak,
        peak_sensitivity_rad_per_s=at_rad_per_s,
        noise_to_command_1=noise_gain(loop, 0),
        noise_to_command_2=noise_gain(loop, 1),
    )


def law_in(table: Table, effectiveness: tuple[float, float]) -> LinearController:
    """The acting law in this state: every loss counts as confirmed.

    The confirmed share of channel 1 is the lost share; the whole channel 1 if channel 2 is lost,
    because d̂ cannot distinguish both losses.
    """
    lost = 1.0 - effectiveness[0]
    return linear_controller(table, lost if lost > 0.0 or effectiveness == HEALTHY else 1.0)


def gain_margins(loop: SampledLoop) -> tuple[float, float]:
    """The factors on the measurement, below and above 1, at a stable ``loop``'s edge.

    A pole can reach the unit circle only where L is real and negative, with the factor -1/L: the
    result is the nearest factors below and above 1. A factor beyond ``MOST_GAIN`` counts as
    infinite, a factor below the inverse as 0.
    """
    angle = loop.angles
    crossing = list(_real_at(loop, angle))
    gain = loop.loop_gain(np.exp(1j * angle))
    for i in np.flatnonzero((gain.imag[:-1] > 0.0) != (gain.imag[1:] > 0.0)):
        if min(gain.real[i], gain.real[i + 1]) < 0.0:
            ends = float(angle[i]), float(angle[i + 1])
            theta = zero(lambda at: loop.gain_at(at).imag, *ends)
            crossing.append(loop.gain_at(theta).real)
    factors = [-1.0 / real for real in crossing if real < -1.0 / MOST_GAIN]
    reduction = max((each for each in factors if each < 1.0), default=0.0)
    increase = min((each for each in factors if each > 1.0), default=math.inf)
    return (reduction if reduction > 1.0 / MOST_GAIN else 0.0), increase


def _real_at(loop: SampledLoop, angle: FloatArray) -> Iterator[float]:
    """L at z = -1, and at z = 1 unless an integrator makes that infinite."""
    yield loop.gain_at(math.pi).real
    if not integrators(loop.lumped.a):
        yield loop.gain_at(0.0).real
        return
    lowest = loop.gain_at(float(angle[0]))  # L may not see the integrator
    if abs(lowest.imag) < abs(lowest.real) * SEEN:
        yield lowest.real


def peak_sensitivity(loop: SampledLoop) -> tuple[float, float]:
    """Largest |S(e^{jωT})| of S = 1/(1 + L), and ω in rad/s where that is."""
    angle = loop.angles
    for _ in range(4):  # each round looks 30 times as closely around the largest
        size = 1.0 / np.abs(1.0 + loop.loop_gain(np.exp(1j * angle)))
        best = int(np.argmax(size))
        low, high = angle[max(best - 1, 0)], angle[min(best + 1, len(angle) - 1)]
        peak, at_angle = float(size[best]), float(angle[best])
        angle = np.linspace(low, high, 61)
    return peak, at_angle / loop.tick_s


def noise_gain(loop: SampledLoop, answer: int) -> float:
    """Rms of u1, u2 or d̂ (``answer`` 0, 1, 2) for white measurement noise of rms 1; exact.

    The covariance P = APAᵀ + bbᵀ is summed by doubling: with P_k the first 2ᵏ terms of ΣAⁱbbᵀAᵀⁱ,
    P_{k+1} = P_k + A^{2ᵏ} P_k A^{2ᵏ}ᵀ (Smith, "Matrix equation XA + BX = C", 1968). Infinite if
    noise reaches the answer through an open integrator.
    """
    loop = loop.lumped
    closed, h = loop.closed(), loop.h[answer] + loop.d[answer, 0] * loop.c
    heard = reaching(closed, h)
    balanced, scaling = linalg.matrix_balance(closed[np.ix_(heard, heard)], permute=False)
    if integrators(balanced) or (np.abs(np.linalg.eigvals(balanced)) >= 1.0).any():
        return math.inf
    scale = np.diag(scaling)
    noise, h = loop.b[heard, 0] / scale, h[heard] * scale
    covariance = energy_of(balanced.T, noise)
    return math.sqrt(float(h @ covariance @ h) + float(loop.d[answer, 0]) ** 2)


def largest_latency_survived(
    design: ContinuousDesign,
    target: Target,
    plant: Plant,
    states: Iterable[tuple[float, float]] = (HEALTHY, TORQUE_DEAD),
    most: int = MAX_LATENCY_TICKS,
) -> int | None:
    """Largest latency up to which the loop is stable in every state, or None.

    The controller knows the latency: each latency has a separate table.
    """
    states = tuple(states)
    for latency in range(most + 1):
        late = replace(target, latency_ticks=latency)
        if not is_stable_in(design, late, plant, states):
            return latency - 1 if latency else None
    return most


def is_stable_in(
    design: ContinuousDesign,
    target: Target,
    plant: Plant,
    states: Iterable[tuple[float, float]],
    extra_delay_ticks: float = 0.0,
    most_sensitive: float = math.inf,
) -> bool:
    """Whether ``design`` on ``target`` can be built and is stable in all ``states``.

    The peak |S| must be at most ``most_sensitive``.
    """
    try:
        table = build(design, target)
    except DesignError:
        return False
    loops = [
        sampled_loop(law_in(table, state), plant, target.tick_s, state, extra_delay_ticks)
        for state in states
    ]
    if not all(loop.spectral_radius() < 1.0 for loop in loops):
        return False
    return math.isinf(most_sensitive) or all(
        peak_sensitivity(loop)[0] <= most_sensitive for loop in loops
    )
