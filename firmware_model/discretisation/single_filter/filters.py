"""A single discretised filter from any continuous filter, for unit tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from firmware_model.compiled import compiled
from firmware_model.discretisation.rules import Rule
from firmware_model.discretisation.sections import ComplexArray, Sections
from firmware_model.discretisation.single_filter.c_source import c_source
from firmware_model.discretisation.systems import zero_pole_gain
from firmware_model.discretisation.tustin import RULES, tustin
from firmware_model.errors import ParameterError
from firmware_model.target.filters import biquad
from firmware_model.target.structs import (
    MAX_SECTIONS,
    FloatArray,
    Precision,
    Record,
    RecordArray,
    record_type,
)


class Filter:
    """A discretised filter with a private state: ``step`` is ``biquad.advance``.

    Attributes:
        sections: the second-order sections, with the stored coefficients.
        tick_s: sampling period, seconds.
        rule: the discretisation.
        prewarp_rad_per_s: the frequency at which Tustin kept the response, or None.
        precision: of coefficients, state and arithmetic.
        cascade: the same constants as the record of ``biquad.CONSTANTS`` that runs. Read-only.
    """

    def __init__(
        self,
        sections: Sections,
        rule: Rule,
        prewarp_rad_per_s: float | None,
        precision: Precision,
    ) -> None:
        """Store ``sections`` in ``precision``; ``discretise`` makes them."""
        self._exact = sections
        stored = _stored(sections.coefficients, precision)
        self.sections = Sections(stored.astype(np.float64), sections.tick_s)
        self.tick_s = sections.tick_s
        self.rule = rule
        self.prewarp_rad_per_s = prewarp_rad_per_s
        self.precision = precision
        self._cascades = np.zeros(1, record_type(biquad.CONSTANTS, precision))
        self._cascades["n"] = len(stored)
        self._cascades["coefficients"][0, : len(stored)] = stored
        self._cascades.flags.writeable = False
        self.cascade: Record = self._cascades[0]  # a record taken earlier could still be written
        self._states = np.zeros(1, record_type(biquad.STATE, precision))

    def in_precision(self, precision: Precision) -> Filter:
        """The same filter at rest, stored and computed in ``precision``.

        Raises:
            ParameterError: an unknown precision, or a precision too small for a coefficient.
        """
        _require_precision(precision)
        return Filter(self._exact, self.rule, self.prewarp_rad_per_s, precision)

    def step(self, u: float) -> float:
        """The answer to the sample ``u``, and the state one tick later."""
        return float(biquad.advance(self.cascade, self._states[0], self._real(u)))

    def run(self, u: ArrayLike) -> FloatArray:
        """The answers to the samples ``u``, shape (n,), in the filter's precision.

        The run continues from the state after the last call.

        Raises:
            ParameterError: ``u`` is not one row of real numbers.
        """
        samples = np.asarray(u)
        if samples.ndim != 1 or samples.dtype.kind not in "iufb":
            raise ParameterError(f"u has shape {samples.shape}: must be one row of real samples")
        inputs = np.ascontiguousarray(samples, self.precision)
        outputs = np.empty_like(inputs)
        _run(self._cascades, self._states, inputs, outputs)
        return outputs

    def reset(self, u: float = 0.0) -> float:
        """Settle into the steady state for a constant input ``u``; returns the output there.

        A section that integrates has no steady state unless its input is zero: it is left at rest.
        """
        return float(biquad.settle(self.cascade, self._states[0], self._real(u)))

    def frequency_response(self, rad_per_s: ArrayLike) -> ComplexArray:
        """H(e^{jωT}) of the stored coefficients at ω, an array of any shape, in rad/s."""
        return self.sections.at_delta(_on_circle(np.asarray(rad_per_s, np.float64) * self.tick_s))

    @property
    def poles(self) -> ComplexArray:
        """Poles in z, shape (order,)."""
        delta = [np.roots(below) for _, below in map(_fraction, self.sections.coefficients)]
        return 1.0 + np.concatenate(delta).astype(np.complex128)

    @property
    def order(self) -> int:
        """The number of poles."""
        return len(self.poles)

    @property
    def dc_gain(self) -> float:
        """The limit for z → 1; an infinity where the filter integrates."""
        gain, zeros = 1.0, 0.0
        for above, below in map(_fraction, self.sections.coefficients):
            (numerator, order), (denominator, poles) = _lowest(above), _lowest(below)
            gain *= numerator / denominator
            zeros += order - poles
        return gain if zeros == 0 else 0.0 if zeros > 0 else math.copysign(math.inf, gain)

    @property
    def is_stable(self) -> bool:
        """Whether the stored coefficients have every pole inside the unit circle."""
        # |1 + δ| < 1 from δ: near z = 1, δ has more digits than z
        delta = [np.roots(below) for _, below in map(_fraction, self.sections.coefficients)]
        return all(2.0 * d.real + abs(d) ** 2 < 0.0 for d in np.concatenate(delta))

    def to_scipy_sos(self) -> FloatArray:
        """The sections in powers of 1/z for ``scipy.signal.sosfilt``, shape (sections, 6).

        For a filter slow relative to the tick, standard sections have fewer digits than sections in
        δ.
        """
        return self.sections.sos

    def to_c(self, name: str = "filter") -> dict[str, str]:
        """The filter as complete C99, text by file name: ``name.h`` and ``name.c``.

        ``name_step`` and ``name_reset`` return the same bits as ``step`` and ``reset``.

        Args:
            name: name of the files and of the state's struct, and prefix of the functions.

        Raises:
            ParameterError: ``name`` is no C identifier.
        """
        return c_source(self.sections.coefficients, self.precision, name, repr(self)[1:-1])

    def __repr__(self) -> str:
        """Order, rule, tick, precision, DC gain, and how near the poles are to the circle."""
        rule: str = self.rule
        if self.prewarp_rad_per_s is not None:
            rule += f" prewarped at {self.prewarp_rad_per_s:g} rad/s"
        radius = f", largest |pole| {np.abs(self.poles).max():.6g}" if self.order else ""
        return (
            f"<Filter of order {self.order}, {rule}, tick {self.tick_s:g} s, {self.precision}: "
            f"DC gain {self.dc_gain:.6g}{radius}>"
        )

    def _real(self, u: float) -> float:
        return cast(float, np.float32(u)) if self.precision == "float32" else float(u)


def discretise(
    system: object,
    tick_s: float,
    rule: Rule = "tustin",
    *,
    prewarp_rad_per_s: float | None = None,
    precision: Precision = "float64",
) -> Filter:
    """A continuous filter as the second-order sections that the firmware runs.

    The gain is spread over the sections by powers of two, so float32 holds every signal between
    sections; powers of two change no bit of an answer.

    Args:
        system: one input, one output: a ``TransferFunction`` or ``StateSpace`` of python-control
            or ``scipy.signal``, a ``ZerosPolesGain``, a ``ZeroPoleGain``, or ``(num, den)`` with
            the highest power of s first.
        tick_s: sampling period, seconds.
        rule: ``tustin``; ``tustin-held``, for an input held over each tick; or ``zoh``, exact for a
            held input.
        prewarp_rad_per_s: frequency at which ``tustin`` keeps the response exactly.
        precision: ``float64`` or ``float32``, of coefficients, state and arithmetic.

    Raises:
        ParameterError: an invalid filter, tick, rule or precision; an order above 16.
        ImproperError: more zeros than poles, or feedthrough with ``tustin-held``.
    """
    if not _is_number(tick_s):
        raise ParameterError(f"tick_s = {tick_s!r}: must be one number of seconds (one rate)")
    if not (isinstance(rule, str) and rule in RULES):
        raise ParameterError(f"rule = {rule!r}: must be one of {', '.join(RULES)}")
    _require_precision(precision)
    if not (prewarp_rad_per_s is None or _is_number(prewarp_rad_per_s)):
        raise ParameterError(f"prewarp_rad_per_s = {prewarp_rad_per_s!r}: must be one frequency")
    if rule != "tustin" and prewarp_rad_per_s is not None:
        raise ParameterError(f"prewarp_rad_per_s with rule = {rule}: must be left out, or tustin")
    g = zero_pole_gain(system)
    if g.order > 2 * MAX_SECTIONS:
        raise ParameterError(
            f"a filter of order {g.order}: must be of order {2 * MAX_SECTIONS} or less, which is "
            "what the controller's layout holds; split it into filters in series"
        )
    tick_s = float(tick_s)
    sections = tustin(g, tick_s, prewarp_rad_per_s) if rule == "tustin" else RULES[rule](g, tick_s)
    return Filter(_spread(sections), rule, prewarp_rad_per_s, precision)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.floating) and not isinstance(value, bool)


def _require_precision(precision: object) -> None:
    if not (isinstance(precision, str) and precision in ("float64", "float32")):
        raise ParameterError(f"precision = {precision!r}: must be float64 or float32")


@compiled
def _run(cascades: RecordArray, states: RecordArray, u: FloatArray, y: FloatArray) -> None:
    for k in range(len(u)):
        y[k] = biquad.advance(cascades[0], states[0], u[k])


def _stored(coefficients: FloatArray, precision: Precision) -> FloatArray:
    """The coefficients in ``precision``; ``ParameterError`` for a coefficient out of range."""
    with np.errstate(over="ignore", under="ignore"):
        stored = coefficients.astype(precision)
    least = np.finfo(precision).tiny
    lost = ~np.isfinite(stored) | ((np.abs(stored) < least) & (coefficients != 0.0))
    if lost.any():
        raise ParameterError(
            f"a coefficient of {coefficients[lost][0]:.3g} is outside the range of {precision}: "
            "poles must be faster or the tick longer"
        )
    return cast(FloatArray, stored)


def _spread(sections: Sections) -> Sections:
    """The same filter with gains of the same size in all sections, by powers of two."""
    poles = np.angle(sections.poles)
    delta = _on_circle(np.array([*poles[poles > 0.0], 1e-9, math.pi / 2.0, math.pi]))
    exponents = []
    for row in sections.coefficients:
        with np.errstate(divide="ignore", invalid="ignore"):  # a pole on the circle
            size = np.abs(Sections(row[None].copy(), sections.tick_s).at_delta(delta)).max()
        exponents.append(int(np.frexp(size)[1]) if np.isfinite(size) else 0)
    share, left = divmod(sum(exponents), len(exponents))
    coefficients = sections.coefficients.copy()
    for i, exponent in enumerate(exponents):
        coefficients[i, :3] = np.ldexp(coefficients[i, :3], share + (i < left) - exponent)
    return Sections(coefficients, sections.tick_s)


def _on_circle(angles: FloatArray) -> ComplexArray:
    """e^{jθ} - 1 at θ in radians, any shape, with all digits near θ = 0."""
    half = 0.5 * angles
    return np.asarray(2j * np.sin(half) * np.exp(1j * half))


def _fraction(row: FloatArray) -> tuple[Sequence[float], Sequence[float]]:
    """Numerator and denominator in δ, without the δ/δ of a section of lower order."""
    above, below = [float(b) for b in row[:3]], [1.0, *(float(a) for a in row[3:])]
    while above[-1] == 0.0 and below[-1] == 0.0:
        del above[-1], below[-1]
    return above, below


def _lowest(polynomial: Sequence[float]) -> tuple[float, float]:
    """The coefficient of the lowest non-zero power of δ, and the power; for zero, 0 and ∞."""
    for power, coefficient in enumerate(reversed(polynomial)):
        if coefficient != 0.0:
            return coefficient, power
    return 0.0, math.inf
