"""The whitener W: noise and disturbances of a healthy plant leave W as white noise.

Without a fault d̂ is not zero: the sensor adds coloured noise, and wind, a banked road or a slow
drift push the plant. Noise and disturbance have a known spectrum Φ, and

    |W|² Φ = S,  W = 1 + w₁/z + ...

makes white noise of variance S of both (Anderson and Moore, Optimal Filtering, 1979, chapter 9).
Every signature of a fault passes W too, so W keeps the evidence of all linear tests.
``discretisation.whitening`` designs W. A row of ``memory`` belongs to one signal.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import FloatArray, Struct

WHITENER_SECTIONS = 2
ONE_SIGNAL = (1, WHITENER_SECTIONS, 2)


class Constants(Struct):
    """Constants."""

    coefficients: Annotated[
        FloatArray, "1", "β0, β1, β2, α1, α2 as in ``biquad``", (WHITENER_SECTIONS, 5)
    ]
    n: Annotated[int, "1", "number of sections in use; 0: W = 1"]


@firmware
def whiten(constants: Constants, memory: FloatArray, row: int, signal: float) -> float:
    """Return W of ``signal`` in this tick and advance the memory of that signal by a tick."""
    c, u = constants.coefficients, signal
    for i in range(constants.n):
        y = c[i, 0] * u + memory[row, i, 0]
        memory[row, i, 0] += c[i, 1] * u - c[i, 3] * y + memory[row, i, 1]
        memory[row, i, 1] += c[i, 2] * u - c[i, 4] * y
        u = y
    return u


@firmware
def settle_whitener(constants: Constants, memory: FloatArray, row: int, signal: float) -> None:
    """Put the memory of a signal into the steady state for a constant ``signal``."""
    c, u = constants.coefficients, signal
    for i in range(constants.n):
        y = real(0.0, u)
        if c[i, 4] != 0.0:
            y = u * c[i, 2] / c[i, 4]
        elif c[i, 3] != 0.0:
            y = u * c[i, 1] / c[i, 3]
        memory[row, i, 0] = y - c[i, 0] * u
        memory[row, i, 1] = c[i, 3] * y - c[i, 1] * u
        u = y


@firmware
def add_memory(
    constants: Constants, memory: FloatArray, row: int, factor: float, other: FloatArray
) -> None:
    """Add ``factor`` times another signal, of which ``other`` is the memory, to a signal."""
    for i in range(constants.n):
        for j in range(2):
            memory[row, i, j] += factor * other[0, i, j]
