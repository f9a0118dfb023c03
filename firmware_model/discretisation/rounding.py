"""How far rounding can move a filter: bounds from its coefficients, to first order.

``conditioning`` bounds a response: a single rounding of each root, coefficient or matrix moves the
response by at most this many roundings. ``run_error`` bounds a run: the rounding of each operation
of ``biquad.advance``, followed to the output.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from firmware_model.compiled import compiled
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.held_input import sampled, zeros_of
from firmware_model.discretisation.sections import ComplexArray, Sections
from firmware_model.discretisation.systems import Polynomials, StateSpace
from firmware_model.law.core import biquad
from firmware_model.law.structs import FloatArray, Precision, Records, zeroed

ROUNDING: dict[Precision, float] = {"float64": 2.0**-53, "float32": 2.0**-24}
"""Relative error of one rounding."""


def of_sections(sections: Sections, delta: ComplexArray) -> FloatArray:
    """Conditioning of the response at ``delta``, shape (m,): Σ|terms|/|sum| of each polynomial."""
    total = np.zeros(delta.shape)
    for b0, b1, b2, a1, a2 in sections.coefficients:
        for row in ((b0, b1, b2), (1.0, a1, a2)):
            total += _cancellation(np.trim_zeros(np.array(row), "b"), delta)
    return total


def of_system(system: ZeroPoleGain | Polynomials | StateSpace, s: ComplexArray) -> FloatArray:
    """Conditioning of a continuous response at ``s``, shape (m,), in the form it is given in."""
    if isinstance(system, ZeroPoleGain):
        roots = np.array([*system.zeros, *system.poles], np.complex128)
        points = s[:, None]
        return np.asarray(
            1.0 + ((np.abs(points) + np.abs(roots)) / np.abs(points - roots)).sum(axis=1)
        )
    if isinstance(system, Polynomials):
        size = len(system.num) + len(system.den)
        return size * (_cancellation(system.num, s) + _cancellation(system.den, s))
    return _of_state_space(system, s)


def _of_state_space(system: StateSpace, s: ComplexArray) -> FloatArray:
    """Conditioning of poles and response, the worst over ``s``: the accuracy of the zeros.

    ‖a‖‖(sI - a)⁻¹‖, and (‖a‖‖x‖‖y‖ + ‖b‖‖y‖ + ‖c‖‖x‖)/|H| for x = (sI - a)⁻¹b, y = c(sI - a)⁻¹.
    """
    if not len(system.a):
        return np.ones(len(s))
    a, (scale, _) = linalg.matrix_balance(system.a, permute=False, separate=True)
    b, c = system.b / scale[:, None], system.c * scale
    resolvent = np.linalg.inv(s[:, None, None] * np.eye(len(a)) - a)
    whole, x, y = (
        np.linalg.norm(m, axis=(1, 2)) for m in (resolvent, resolvent @ b, c @ resolvent)
    )
    of_a, of_b, of_c = (np.linalg.norm(m) for m in (a, b, c))
    with np.errstate(divide="ignore"):  # for a sum without correct digits
        of_response = (of_a * x * y + of_b * y + of_c * x + abs(system.d)) / np.abs(system(s))
    return np.full(len(s), len(a) * np.max(of_a * whole + of_response))


def of_held(g: ZeroPoleGain, tick_s: float, delta: ComplexArray) -> FloatArray:
    """Roundings of the response at ``delta``, shape (m,), of ``g`` with an input held over a tick.

    The exact state space is rounded twice: on the way to the response, and on the way to each
    zero, which the roundings at the zero move by the quotient of them and the response's slope.
    """
    g = g.cancelled()
    if not g.poles:
        return np.full(delta.shape, abs(g.gain))
    a, b, c = sampled(g, tick_s)
    through = g.feedthrough
    answer, _, roundings = _of_entries(a, b, c, through, delta, of_exponential=True)
    poles = np.linalg.eigvals(a).astype(np.complex128)
    zeros = np.array(zeros_of((a, b, c), through, poles), np.complex128)
    if not zeros.size:
        return roundings
    try:
        _, slope, size = _of_entries(a, b, c, through, zeros)
    except np.linalg.LinAlgError:  # a zero on a pole
        return np.full(delta.shape, np.inf)
    with np.errstate(all="ignore"):
        moved = (size / slope / np.abs(delta[:, None] - zeros)).sum(axis=1)
    return np.asarray(roundings + moved * np.abs(answer))


def of_coefficients(system: ZeroPoleGain | Polynomials | StateSpace, z: ComplexArray) -> FloatArray:
    """Conditioning of a sampled response at ``z``, shape (m,): each coefficient rounded alone."""
    if not isinstance(system, StateSpace):
        return of_system(system, z)
    answer, _, roundings = _of_entries(system.a, system.b, system.c, system.d, z)
    with np.errstate(divide="ignore"):
        return np.asarray(roundings / np.abs(answer))


def _of_entries(
    a: FloatArray,
    b: FloatArray,
    c: FloatArray,
    d: float,
    points: ComplexArray,
    *,
    of_exponential: bool = False,
) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """The response at ``points``, its slope, and what roundings of each entry do to the response.

    With R = (xI - a)⁻¹: |c R|(|a| + |x|)|R b| + |c||R b| + |c R||b| + |d|. A matrix exponential
    rounds an entry of ``a`` or ``b`` as if of the size of the largest in its row and column.
    """
    eye = np.eye(len(a))
    resolvent = np.linalg.inv(points[:, None, None] * eye - a)
    x, y = resolvent @ b, c @ resolvent
    entries = np.abs(a)
    if of_exponential:
        entries = entries + np.sqrt(np.outer(entries.max(axis=1), entries.max(axis=0)))
    inputs = np.full(b.shape, np.abs(b).max()) if of_exponential else np.abs(b)
    size = np.abs(y) @ (entries + np.abs(points)[:, None, None] * eye) @ np.abs(x)
    size = size + np.abs(c) @ np.abs(x) + np.abs(y) @ inputs
    return (c @ x)[:, 0, 0] + d, np.abs(y @ x)[:, 0, 0], size[:, 0, 0] + abs(d)


def _cancellation(polynomial: FloatArray, x: ComplexArray) -> FloatArray:
    """Σ|terms|/|sum| of a polynomial, highest power first, at ``x``; 1 for the zero polynomial."""
    if not np.any(polynomial):
        return np.ones(x.shape)
    terms = np.polyval(np.abs(polynomial), np.abs(x))
    return np.asarray(terms / np.abs(np.polyval(polynomial, x)))


def run_error(sections: Sections, ticks: int, precision: Precision = "float32") -> float:
    """Bound of the effect of ``precision`` on a run from rest, as a share of the largest input.

    Each section is, per tick, y = β0 u + s1, s1 += β1 u - α1 y + s2, s2 += β2 u - α2 y. Each signal
    is at most the largest input times the summed magnitudes of the signal's impulse response; each
    product is rounded twice, once with the coefficient, and each sum once; the gain from a signal's
    error to the output is the summed magnitudes of the output after an impulse at the signal. The
    bound ignores underflow.
    """
    coefficients = sections.coefficients
    unit, error, u = ROUNDING[precision], 0.0, 1.0
    for i, (b0, b1, b2, a1, a2) in enumerate(np.abs(coefficients)):
        y, s1, s2 = _sums(coefficients[: i + 1], ticks, impulse_at=None)
        to_output_1, to_output_2 = (
            _sums(coefficients[i:], ticks, impulse_at=j)[0] for j in range(2)
        )
        onwards = _sums(coefficients[i + 1 :], ticks, impulse_at=None)[0]
        at_y = 2.0 * b0 * u + y
        at_1 = 4.0 * (b1 * u + a1 * y) + 2.0 * s2 + s1
        at_2 = 3.0 * (b2 * u + a2 * y) + s2
        error += at_y * (onwards + a1 * to_output_1 + a2 * to_output_2)
        error += at_1 * to_output_1 + at_2 * to_output_2
        u = y
    return float(unit * error)


def _sums(coefficients: FloatArray, ticks: int, impulse_at: int | None) -> FloatArray:
    """Σ|y|, and Σ|s1|, Σ|s2| of the last section, after an impulse.

    Args:
        coefficients: coefficients of the cascade, shape (n, 5).
        ticks: duration.
        impulse_at: the first section's accumulator with the impulse; None: the impulse is the
            input.
    """
    if not len(coefficients):
        return np.array([1.0, 0.0, 0.0])
    cascades = zeroed(biquad.Constants, "float64")
    cascades[0].n = len(coefficients)
    cascades[0].coefficients[: len(coefficients)] = coefficients
    states = zeroed(biquad.State, "float64")
    if impulse_at is not None:
        states[0].accumulators[0, impulse_at] = 1.0
    sums = np.zeros(3)
    _add_magnitudes(cascades, states, 1.0 if impulse_at is None else 0.0, ticks, sums)
    return sums


@compiled
def _add_magnitudes(
    cascades: Records[biquad.Constants],
    states: Records[biquad.State],
    u: float,
    ticks: int,
    sums: FloatArray,
) -> None:
    last = cascades[0].n - 1
    for _ in range(ticks):
        sums[0] += abs(biquad.advance(cascades[0], states[0], u))
        sums[1] += abs(states[0].accumulators[last, 0])
        sums[2] += abs(states[0].accumulators[last, 1])
        u = 0.0
