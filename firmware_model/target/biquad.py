"""Second-order sections as they run on the target: transposed direct form II in δ = z - 1.

    y   = β0 u + s1
    s1 += β1 u - α1 y + s2
    s2 += β2 u - α2 y

Two accumulators a section, five coefficients, no division, no allocation. ``coefficients`` is
(n, 5) and ``state`` is (n, 2), both in the table's own precision; ``n`` sections of them are used.
"""

from __future__ import annotations

from typing import Any

from firmware_model.compiled import firmware

Array = Any  # a float32 or float64 array; numba compiles one version for each


@firmware
def output(coefficients: Array, state: Array, n: int, u: float) -> float:
    """What the cascade answers to ``u`` now; the state stays as it is."""
    for i in range(n):
        u = coefficients[i, 0] * u + state[i, 0]
    return u


@firmware
def advance(coefficients: Array, state: Array, n: int, u: float) -> float:
    """The same answer, and the state one tick later."""
    for i in range(n):
        y = coefficients[i, 0] * u + state[i, 0]
        state[i, 0] += coefficients[i, 1] * u - coefficients[i, 3] * y + state[i, 1]
        state[i, 1] += coefficients[i, 2] * u - coefficients[i, 4] * y
        u = y
    return u


@firmware
def settle(coefficients: Array, state: Array, n: int, u: float) -> float:
    """Put the cascade where a constant input ``u`` would have brought it; returns its output.

    A section that integrates has no such place for ``u`` other than zero: it is left at rest.
    """
    for i in range(n):
        b0, b1, b2 = coefficients[i, 0], coefficients[i, 1], coefficients[i, 2]
        a1, a2 = coefficients[i, 3], coefficients[i, 4]
        y = u * b0
        if a2 != 0.0:
            y = u * b2 / a2
        elif a1 != 0.0:
            y = u * b1 / a1
        state[i, 0] = y - b0 * u
        state[i, 1] = a1 * y - b1 * u
        u = y
    return u


@firmware
def settle_integrator(coefficients: Array, state: Array, n: int, y: float) -> None:
    """Put the cascade where its input is zero and its integrator holds the output at ``y``.

    Sections after the integrator are settled backwards from ``y``; those before it rest at zero.
    """
    for k in range(n):
        i = n - 1 - k
        b0, b1, b2 = coefficients[i, 0], coefficients[i, 1], coefficients[i, 2]
        a1, a2 = coefficients[i, 3], coefficients[i, 4]
        u = y - y  # a zero of the table's own precision
        if a2 != 0.0:
            u = y * a2 / b2
        elif a1 != 0.0 and b2 == 0.0:
            u = y * a1 / b1
        state[i, 0] = y - b0 * u
        state[i, 1] = a1 * y - b1 * u
        y = u
