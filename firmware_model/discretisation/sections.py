"""Second-order sections in the delta operator: the runtime form of every filter.

With ``δ = z - 1`` a section is

    H(δ) = (β0 δ² + β1 δ + β2) / (δ² + α1 δ + α2)

and α1, α2 are small numbers (of size |p|T and |p|²T²) instead of differences of numbers near 2 and
1. A pole at 1 rad/s sampled at 10 kHz has α2 ~ 1e-8: stored as ``1 + a1 + a2`` the number would
   keep one digit in float32 and eight in float64; stored directly the number keeps all digits
   (Middleton and Goodwin, "Improved finite word length characteristics in digital control using
   delta operators", 1986). No function expands a filter into one polynomial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_model.errors import DesignError, ImproperError
from firmware_model.law.structs import FloatArray

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Sections:
    """A cascade of delta-operator second-order sections.

    Attributes:
        coefficients: shape (n, 5), one row a section: β0, β1, β2, α1, α2. Read-only.
        tick_s: sampling period, seconds.
    """

    coefficients: FloatArray
    tick_s: float

    def __post_init__(self) -> None:
        self.coefficients.flags.writeable = False

    def __call__(self, z: ComplexArray) -> ComplexArray:
        """Transfer function at ``z``, any shape; z = e^{jωT} gives the frequency response."""
        return self.at_delta(np.asarray(z, dtype=np.complex128) - 1.0)

    def at_delta(self, delta: ComplexArray) -> ComplexArray:
        """Transfer function at δ = z - 1, any shape; near z = 1, δ has more digits than z."""
        response = np.ones_like(delta)
        for b0, b1, b2, a1, a2 in self.coefficients:
            if a2 == 0.0 and b2 == 0.0:  # δ/δ cancels, also at δ = 0
                first_order = (b0 * delta + b1) / (delta + a1) if a1 or b1 else b0
                response = response * first_order
                continue
            response = response * (((b0 * delta + b1) * delta + b2) / ((delta + a1) * delta + a2))
        return response

    @property
    def feedthrough(self) -> float:
        """Feedthrough from this tick's input to this tick's output, H(z → ∞)."""
        return float(np.prod(self.coefficients[:, 0]))

    @property
    def poles(self) -> ComplexArray:
        """Poles in z, shape (2n,); a first-order section counts one more at z = 1, cancelled."""
        roots = [np.roots([1.0, a1, a2]) for *_, a1, a2 in self.coefficients]
        return 1.0 + np.concatenate(roots).astype(np.complex128)

    @property
    def sos(self) -> FloatArray:
        """The same cascade as scipy's ``sos``, shape (n, 6): b0 b1 b2 1 a1 a2 in powers of 1/z.

        A first-order section stays one; its δ/δ would be 0/0 at z = 1.
        """
        b0, b1, b2, a1, a2 = self.coefficients.T
        first = (b2 == 0.0) & (a2 == 0.0)
        above = [b0, b1 - np.where(first, 1.0, 2.0) * b0, np.where(first, 0.0, b0 - b1 + b2)]
        below = [a1 - np.where(first, 1.0, 2.0), np.where(first, 0.0, 1.0 - a1 + a2)]
        return np.stack([*above, np.ones_like(b0), *below], axis=1)


def from_delta_zpk(
    zeros: Sequence[complex] | ComplexArray,
    poles: Sequence[complex] | ComplexArray,
    gain: float,
    tick_s: float,
) -> Sections:
    """Pair zeros and poles in δ into sections, each pole with the nearest zeros.

    Raises:
        ImproperError: more zeros than poles, a filter that needs its future input.
    """
    if len(zeros) > len(poles):
        raise ImproperError(
            f"a filter with {len(zeros)} zeros and {len(poles)} poles needs its future input: "
            "must have at least as many poles as zeros"
        )
    pole_groups, zero_groups = _by_two(poles), _by_two(zeros)
    if not pole_groups:
        return Sections(np.array([[gain, 0.0, 0.0, 0.0, 0.0]]), tick_s)
    partners: list[list[complex]] = [[] for _ in pole_groups]
    for group in zero_groups:
        free = [i for i, p in enumerate(pole_groups) if not partners[i] and len(p) >= len(group)]
        nearest = min(free, key=lambda i: abs(sum(pole_groups[i]) / len(pole_groups[i]) - group[0]))
        partners[nearest] = group
    rows = [section(z, p) for z, p in zip(partners, pole_groups, strict=True)]
    rows[0][:3] *= gain
    return Sections(np.array(rows), tick_s)


def make_up_gain(sections: Sections) -> FloatArray:
    """The gain of ``target.filters.shortfall`` for a stable model G, shape (n, 2), n its sections.

    With x⁺ = A x - B v, y = c x - d v over the accumulators that signals reach, v minimises

        y² + x⁺ᵀ P x⁺,  P = Aᵀ P A + cᵀ c:   v = (d c + Bᵀ P A) x/(d² + Bᵀ P B).
    """
    a, b, c, d, reached = realisation(sections)
    energy = energy_of(a, c)
    above, below = d * c + b @ energy @ a, d * d + b @ energy @ b
    gain = np.zeros((len(sections.coefficients), 2))
    if below > 0.0:
        gain.flat[reached] = above / below
    return gain


def _by_two(roots: Sequence[complex] | ComplexArray) -> list[list[complex]]:
    """Conjugate pairs, then real roots in pairs by size, then a single last root."""
    upper = sorted((complex(r) for r in roots if r.imag > 0), key=abs)
    real = sorted((complex(r) for r in roots if r.imag == 0), key=abs)
    return [[r, r.conjugate()] for r in upper] + [real[i : i + 2] for i in range(0, len(real), 2)]


def section(zeros: list[complex], poles: list[complex]) -> FloatArray:
    """β0 β1 β2 α1 α2 of Π(δ - zero)/Π(δ - pole).

    A first-order section is multiplied by δ/δ: its second accumulator then stays exactly zero.
    """
    above, below = np.poly(zeros).real, np.poly(poles).real
    order = len(poles)
    row = np.zeros(5)
    row[order - len(zeros) : order + 1] = above
    row[3 : 3 + order] = below[1:]
    return row


def energy_of(a: FloatArray, c: FloatArray) -> FloatArray:
    """P = Σ (Aᵀ)ᵏ cᵀ c Aᵏ of a stable A, by doubling: no digits are lost, however slow A is.

    Raises:
        DesignError: A is not stable.
    """
    energy, power = np.outer(c, c), a
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(64):  # 2⁶⁴ ticks: the slowest mode below 1 has faded
            if not power.any():
                return energy
            energy = energy + power.T @ energy @ power
            power = power @ power
    raise DesignError("a pole is too close to 0 rad/s for double precision: must be 0 or faster")


def reaching(a: FloatArray, row: FloatArray) -> NDArray[np.bool_]:
    """Which states (n,) reach ``row`` ξ by a path of non-zeros of ``a``."""
    reaches, steps = np.asarray(row != 0.0, dtype=np.bool_), a != 0.0
    while True:
        wider = reaches | (reaches @ steps)
        if (wider == reaches).all():
            return reaches
        reaches = wider


def realisation(sections: Sections) -> tuple[FloatArray, FloatArray, FloatArray, float, list[int]]:
    """A, B, c, d of the cascade over the accumulators of ``biquad`` that ever leave zero."""
    size = 2 * len(sections.coefficients)
    a, b, c, d = np.zeros((size, size)), np.zeros(size), np.zeros(size), 1.0
    reached = []
    for i, (b0, b1, b2, a1, a2) in enumerate(sections.coefficients):
        first, second = 2 * i, 2 * i + 1
        reached += [first] * bool(b1 or a1 or b2 or a2) + [second] * bool(b2 or a2)
        y, direct = b0 * c, b0 * d  # output of this section for the input (c, d)
        y[first] += 1.0
        a[first, [first, second]] = 1.0
        a[second, second] = 1.0
        for row, beta, alpha in ((first, b1, a1), (second, b2, a2)):
            a[row] += beta * c - alpha * y
            b[row] = beta * d - alpha * direct
        c, d = y, direct
    return a[np.ix_(reached, reached)], b[reached], c[reached], d, reached
