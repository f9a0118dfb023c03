"""The covariance P of a small Kalman filter as U D Uᵀ, U unit upper triangular and D diagonal.

P itself, updated tick by tick, does not stay positive semidefinite: in single precision the
subtraction of what a measurement says leaves it indefinite within a second, in double where there
is no noise, and the variance of an innovation below zero. Its factors cannot leave it: no D is ever
the result of a subtraction (Bierman, Factorization Methods for Discrete Sequential Estimation,
1977, V.3 for the measurement, and the rank-one update of Agee and Turner for what is added).
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import FloatArray, Struct

MAX_DIRECTIONS = 4
LOSS_STATES = 2  # of a confirmed loss: share and moment
MAX_STATES = LOSS_STATES + MAX_DIRECTIONS + 1  # these, directions, the remainder
SIZES = (MAX_STATES,)


class State(Struct):
    """State."""

    upper: Annotated[FloatArray, "1", "U above its diagonal of ones", (MAX_STATES, MAX_STATES)]
    variances: Annotated[FloatArray, "1", "D", SIZES]
    projected: Annotated[FloatArray, "y", "Uᵀ x of the last measurement", SIZES]
    added: Annotated[FloatArray, "1", "direction of the added term", SIZES]


@firmware
def measure(state: State, n: int, x: FloatArray, noise: float, gain: FloatArray) -> float:
    """P after a measurement xᵀθ + white noise of variance ``noise``, above 0.

    Args:
        state: of this module; changed in place.
        n: states in use.
        x: shape (n,) or longer.
        noise: variance, in the unit of x².
        gain: P x/S, shape as x; written.

    Returns:
        S = xᵀ P x + noise, with the P of before.
    """
    upper, variances, projected = state.upper, state.variances, state.projected
    for j in range(n):
        projected[j] = x[j]
        for i in range(j):
            projected[j] += upper[i, j] * x[i]
    variance = noise
    for j in range(n):
        before = variance
        seen = variances[j] * projected[j]
        variance = before + projected[j] * seen
        variances[j] *= before / variance
        gain[j] = seen
        for i in range(j):
            old = upper[i, j]
            upper[i, j] = old - projected[j] / before * gain[i]
            gain[i] += old * seen
    for j in range(n):
        gain[j] /= variance
    return variance


@firmware
def fade(state: State, n: int, memory: FloatArray) -> None:
    """P after each state has been multiplied by its ``memory``, above 0, shape (n,) or longer."""
    upper, variances = state.upper, state.variances
    for j in range(n):
        variances[j] *= memory[j] * memory[j]
        for i in range(j):
            upper[i, j] *= memory[i] / memory[j]


@firmware
def grow(state: State, which: int, variance: float) -> None:
    """P after white noise of ``variance``, 0 or above, has been added to the state ``which``."""
    upper, variances, added = state.upper, state.variances, state.added
    added[:] = 0.0
    added[which] = 1.0
    for k in range(which + 1):
        j = which - k
        before = variances[j]
        variances[j] = before + variance * added[j] * added[j]
        share = real(0.0, variance)
        if variances[j] > share:
            share = variance * added[j] / variances[j]
            variance *= before / variances[j]
        for i in range(j):
            added[i] -= added[j] * upper[i, j]
            upper[i, j] += share * added[i]


@firmware
def variance_of(state: State, n: int, which: int) -> float:
    """The variance in P of the state ``which`` of the ``n`` in use."""
    upper, variances = state.upper, state.variances
    variance: float = variances[which]
    for j in range(which + 1, n):
        variance += upper[which, j] * upper[which, j] * variances[j]
    return variance


@firmware
def replace_loss(state: State, share: float, moment: float) -> None:
    """P with new states of a loss, of these variances, in place of the old; the others stay."""
    state.upper[:LOSS_STATES, 1:] = 0.0
    state.variances[0] = share
    state.variances[1] = moment


@firmware
def clear_covariance(state: State) -> None:
    """P is zero."""
    state.upper[:] = 0.0
    state.variances[:] = 0.0
