"""The whitener W: noise and disturbances of a healthy plant leave W as white noise.

Without a fault d̂ is not zero: the sensor adds coloured noise, and wind, a banked road or a slow
drift push the plant. Noise and disturbance have a known spectrum Φ, and

    |W|² Φ = S,  W = 1 + w₁/z + ...

makes white noise of variance S of both (Anderson and Moore, Optimal Filtering, 1979, chapter 9).
Every signature of a fault passes W too, so W keeps the evidence of all linear tests.
``discretisation.whitening`` designs W.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.structs import FloatArray, Struct

WHITENER_SECTIONS = 2


class Constants(Struct):
    """Constants."""

    coefficients: Annotated[
        FloatArray, "1", "β0, β1, β2, α1, α2 as in ``biquad``", (WHITENER_SECTIONS, 5)
    ]
    n: Annotated[int, "1", "number of sections in use; 0: W = 1", (0, WHITENER_SECTIONS)]


class State(Struct):
    """The memory of one signal."""

    memory: Annotated[FloatArray, "1", "s1, s2, a row a section", (WHITENER_SECTIONS, 2)]


@firmware
def whiten(constants: Constants, state: State, signal: float) -> float:
    """Return W of ``signal`` in this tick and advance the memory of that signal by a tick."""
    c, s, u = constants.coefficients, state.memory, signal
    for i in range(constants.n):
        y = c[i, 0] * u + s[i, 0]
        s[i, 0] += c[i, 1] * u - c[i, 3] * y + s[i, 1]
        s[i, 1] += c[i, 2] * u - c[i, 4] * y
        u = y
    return u


@firmware
def settle_whitener(constants: Constants, state: State, signal: float) -> None:
    """Put the memory of a signal into the steady state for a constant ``signal``."""
    c, s, u = constants.coefficients, state.memory, signal
    for i in range(constants.n):
        y = c[i, 0] * u
        if c[i, 4] != 0.0:
            y = u * c[i, 2] / c[i, 4]
        elif c[i, 3] != 0.0:
            y = u * c[i, 1] / c[i, 3]
        s[i, 0] = y - c[i, 0] * u
        s[i, 1] = c[i, 3] * y - c[i, 1] * u
        u = y


@firmware
def add_signal(constants: Constants, state: State, factor: float, other: State) -> None:
    """Add ``factor`` times the past of another signal to the past of a signal."""
    for i in range(constants.n):
        for j in range(2):
            state.memory[i, j] += factor * other.memory[i, j]
