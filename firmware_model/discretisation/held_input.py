"""A continuous filter with an input held over each tick: exact state space and zeros.

The zeros of c(xI - a)⁻¹b, where x is s or δ, become as exact as the response is.

All quantities are in δ = z - 1 and in units of the tick: slow and fast filters then have numbers of
similar size.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import linalg

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import ComplexArray, from_delta_zpk
from firmware_model.law.structs import FloatArray

REFINEMENTS = 16
"""At most; each triples the digits once there are some, more help only zeros that nearly meet."""


def refined(
    a: FloatArray, b: FloatArray, c: FloatArray, poles: ComplexArray, found: Iterable[complex]
) -> list[complex]:
    """Refine the zeros ``found`` by eigenvalues; eigenvalues miss distant zeros by far.

    Aberth's iteration for all at once on the numerator N(x) = c(xI - a)⁻¹b Π(x - pole): the step is
    N/(N' - N Σ 1/(zero - other)). Real zeros stay real, and pairs stay conjugate. Zeros that cancel
    poles stay unchanged.
    """
    found = list(found)
    real = [root for root in found if root.imag == 0.0]
    upper = [root for root in found if root.imag > 0.0]
    zeros = np.array([*real, *upper, *np.conj(upper)], np.complex128)
    for _ in range(REFINEMENTS):
        distance = zeros[:, None] - zeros
        np.fill_diagonal(distance, np.inf)
        resolvent = zeros[:, None, None] * np.eye(len(a)) - a
        try:
            x = np.linalg.solve(resolvent, np.broadcast_to(b, (len(zeros), *b.shape)))
            slope = -(c @ np.linalg.solve(resolvent, x))[:, 0, 0]
        except np.linalg.LinAlgError:  # a zero that cancels a pole
            return found
        with np.errstate(all="ignore"):
            of_others = (1.0 / (zeros[:, None] - poles)).sum(axis=1) - (1.0 / distance).sum(axis=1)
            step = 1.0 / (slope / (c @ x)[:, 0, 0] + of_others)
        before = zeros.copy()
        zeros -= np.where(np.isfinite(step), step, 0.0)  # exact or double zeros stay
        zeros[: len(real)].imag = 0.0
        zeros[len(real) + len(upper) :] = zeros[len(real) : len(real) + len(upper)].conj()
        if (zeros == before).all():
            break
    return [complex(zero) for zero in zeros]


StateSpace = tuple[FloatArray, FloatArray, FloatArray]


def sampled(g: ZeroPoleGain, tick_s: float) -> StateSpace:
    """``(a, b, c)`` with δx = a x + b u, y = c x + d u; shapes (n, n), (n, 1), (1, n).

    d is the feedthrough of ``g``, which sampling does not change. a = e^{AT} - 1 and b = ∫e^{At}dt
    B, both from the integral, so small numbers keep their digits.
    """
    per_tick = ZeroPoleGain(
        tuple(root * tick_s for root in g.zeros),
        tuple(root * tick_s for root in g.poles),
        g.gain * tick_s**g.relative_degree,
    )
    a, b, c = _balanced(*_cascade(per_tick))
    n = len(b)
    augmented = np.zeros((2 * n, 2 * n))
    augmented[:n, :n] = a
    augmented[:n, n:] = np.eye(n)
    integral = linalg.expm(augmented)[:n, n:]
    return a @ integral, integral @ b, c


def response(system: StateSpace, delta: ComplexArray) -> ComplexArray:
    """c(δI - a)⁻¹b at ``delta``, shape (m,)."""
    a, b, c = system
    resolvent = delta[:, None, None] * np.eye(len(a)) - a
    return np.asarray(
        (c @ np.linalg.solve(resolvent, np.broadcast_to(b, (len(delta), *b.shape))))[:, 0, 0]
    )


def zeros_of(system: StateSpace, feedthrough: float, poles: ComplexArray) -> list[complex]:
    """Finite zeros of c(δI - a)⁻¹b + d: n, the poles of its inverse, and n - 1 where d = 0.

    There are no fewer: the first sample after an input's answers.
    """
    a, b, c = system
    if feedthrough:
        return [complex(zero) for zero in linalg.eigvals(a - b @ c / feedthrough)]
    n = len(a)
    pencil = np.block([[a, b], [c, np.zeros((1, 1))]])
    mass = np.zeros((n + 1, n + 1))
    mass[:n, :n] = np.eye(n)
    roots = linalg.eigvals(pencil, mass)
    found = sorted(roots[np.isfinite(roots)], key=abs)[: n - 1]
    while len(found) < n - 1:  # far out on the negative axis; eigenvalues took it for infinite
        found.append(-8.0 * np.max(np.abs(found), initial=1.0))
    return refined(a, b, c, poles, found)


def _cascade(g: ZeroPoleGain) -> StateSpace:
    """A state space (A, b, c) of ``g``, its feedthrough aside, as a cascade of sections in s."""
    sections = from_delta_zpk(g.zeros, g.poles, g.gain, 1.0).coefficients  # pairing knows no z
    a = np.zeros((0, 0))
    b = np.zeros((0, 1))
    c = np.zeros((1, 0))
    d = 1.0
    for b0, b1, b2, a1, a2 in sections:
        # controllable form; the δ/δ of a first-order section is a state that is never excited
        if a2 == 0.0 and b2 == 0.0:
            ai, bi, ci = np.array([[-a1]]), np.array([[1.0]]), np.array([[b1 - a1 * b0]])
        else:
            ai = np.array([[-a1, -a2], [1.0, 0.0]])
            bi, ci = np.array([[1.0], [0.0]]), np.array([[b1 - a1 * b0, b2 - a2 * b0]])
        a = np.block([[a, np.zeros((len(a), len(ai)))], [bi @ c, ai]])
        b = np.vstack([b, bi * d])
        c = np.hstack([b0 * c, ci])
        d *= float(b0)
    return a, b, c


def _balanced(a: FloatArray, b: FloatArray, c: FloatArray) -> StateSpace:
    """The same system with states scaled by powers of two to numbers of similar size.

    In a cascade of slow and fast sections the numbers span many decades, and eigenvalues lose as
    many digits.
    """
    whole = np.block([[a, b], [c, np.zeros((1, 1))]])
    with np.errstate(invalid="ignore"):  # scipy also reads scales as integers: 2^63 is none
        _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    states = scale[:-1] / scale[-1]
    return a * states / states[:, None], b / states[:, None], c * states
