"""Second-order sections as they run on the target: transposed direct form II in δ = z - 1.

    y   = β0 u + s1
    s1 += β1 u - α1 y + s2
    s2 += β2 u - α2 y

Two accumulators and five coefficients a section, no division, no allocation. A cascade of sections
is one filter.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.structs import MAX_SECTIONS, FloatArray, Precision, Struct, zeroed


class Constants(Struct):
    """Constants."""

    coefficients: Annotated[
        FloatArray, "output/input", "β0, β1, β2, α1, α2, a row a section", (MAX_SECTIONS, 5)
    ]
    n: Annotated[int, "1", "number of sections in use", (0, MAX_SECTIONS)]


class State(Struct):
    """State."""

    accumulators: Annotated[FloatArray, "output", "s1, s2, a row a section", (MAX_SECTIONS, 2)]


def at_rest(precision: Precision = "float64") -> State:
    """Return the state of a cascade at rest, for a cascade outside the law."""
    state: State = zeroed(State, precision)[0]
    return state


@firmware
def output(cascade: Constants, state: State, u: float) -> float:
    """Return the answer to ``u`` in this tick; the state does not change."""
    coefficients, s = cascade.coefficients, state.accumulators
    for i in range(cascade.n):
        u = coefficients[i, 0] * u + s[i, 0]
    return u


@firmware
def advance(cascade: Constants, state: State, u: float) -> float:
    """The same answer, and the state one tick later."""
    coefficients, s = cascade.coefficients, state.accumulators
    for i in range(cascade.n):
        y = coefficients[i, 0] * u + s[i, 0]
        s[i, 0] += coefficients[i, 1] * u - coefficients[i, 3] * y + s[i, 1]
        s[i, 1] += coefficients[i, 2] * u - coefficients[i, 4] * y
        u = y
    return u


@firmware
def settle(cascade: Constants, state: State, u: float) -> float:
    """Put the cascade into its steady state for a constant input ``u``; returns the output.

    A section that integrates has no steady state unless ``u`` is zero: it is left at rest.
    """
    coefficients, s = cascade.coefficients, state.accumulators
    for i in range(cascade.n):
        b0, b1, b2 = coefficients[i, 0], coefficients[i, 1], coefficients[i, 2]
        a1, a2 = coefficients[i, 3], coefficients[i, 4]
        y = u * b0
        if a2 != 0.0:
            y = u * b2 / a2
        elif a1 != 0.0:
            y = u * b1 / a1
        s[i, 0] = y - b0 * u
        s[i, 1] = a1 * y - b1 * u
        u = y
    return u
