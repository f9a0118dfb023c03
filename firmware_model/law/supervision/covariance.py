"""The covariance P of a small Kalman filter as L D Lᵀ, L unit lower triangular and D diagonal.

P itself, updated tick by tick, does not stay positive semidefinite: in single precision the
subtraction of what a measurement says leaves it indefinite within a second, in double where there
is no noise, and the variance of an innovation below zero. Its factors cannot leave it: no D is ever
the result of a subtraction (Bierman, Factorization Methods for Discrete Sequential Estimation,
1977, V.3 for the measurement, and the rank-one update of Agee and Turner for what is added; with
the states in reverse order U D Uᵀ is L D Lᵀ).

Before any loss its two states are unused: they stand first, so that what is added to a later state
never reaches them, and every function works from the ``first`` used state on.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import FloatArray, Struct

MAX_DIRECTIONS = 4
SHARE, MOMENT = 0, 1  # the states of a confirmed loss
LOSS_STATES = 2
MAX_STATES = LOSS_STATES + MAX_DIRECTIONS + 1  # these, directions, the remainder
SIZES = (MAX_STATES,)


class State(Struct):
    """State."""

    first: Annotated[int, "1", "first state in use: 0 after a loss, before any the third"]
    lower: Annotated[FloatArray, "1", "L below its diagonal of ones", (MAX_STATES, MAX_STATES)]
    variances: Annotated[FloatArray, "1", "D", SIZES]
    projected: Annotated[FloatArray, "y", "Lᵀ x of the last measurement", SIZES]
    added: Annotated[FloatArray, "1", "direction of the added term", SIZES]


@firmware
def measure(state: State, n: int, x: FloatArray, noise: float, gain: FloatArray) -> float:
    """P after a measurement xᵀθ + white noise of variance ``noise``, above 0.

    Args:
        state: of this module; changed in place.
        n: end of the states in use.
        x: shape (n,) or longer.
        noise: variance, in the unit of x².
        gain: P x/S, shape as x; written.

    Returns:
        S = xᵀ P x + noise, with the P of before.
    """
    first, lower, variances, projected = state.first, state.lower, state.variances, state.projected
    variance = noise
    for j in range(n - 1, first - 1, -1):
        projection = x[j]
        for i in range(j + 1, n):
            projection += lower[i, j] * x[i]
        projected[j] = projection
    for j in range(n - 1, first - 1, -1):
        before = variance
        seen = variances[j] * projected[j]
        variance = before + projected[j] * seen
        variances[j] *= before / variance
        gain[j] = seen
        for i in range(j + 1, n):
            old = lower[i, j]
            lower[i, j] = old - projected[j] / before * gain[i]
            gain[i] += old * seen
    for i in range(first, n):
        gain[i] /= variance
    return variance


@firmware
def fade(state: State, n: int, memory: FloatArray) -> None:
    """P after each state has been multiplied by its ``memory``, above 0, shape (n,) or longer."""
    first, lower, variances = state.first, state.lower, state.variances
    for j in range(first, n):
        variances[j] *= memory[j] * memory[j]
        for i in range(j + 1, n):
            lower[i, j] *= memory[i] / memory[j]


@firmware
def grow(state: State, n: int, which: int, variance: float) -> None:
    """P after white noise of ``variance``, 0 or above, has been added to the state ``which``."""
    state.added[:] = 0.0
    state.added[which] = 1.0
    add(state, n, which, variance)


@firmware
def add(state: State, n: int, start: int, variance: float) -> None:
    """P after noise along ``state.added``, which is 0 before ``start``, has been added."""
    lower, variances, added = state.lower, state.variances, state.added
    for j in range(start, n):
        before = variances[j]
        variances[j] = before + variance * added[j] * added[j]
        share = real(0.0, variance)
        if variances[j] > share:
            share = variance * added[j] / variances[j]
            variance *= before / variances[j]
        for i in range(j + 1, n):
            added[i] -= added[j] * lower[i, j]
            lower[i, j] += share * added[i]


@firmware
def variance_of(state: State, which: int) -> float:
    """The variance in P of the state ``which``."""
    first, lower, variances = state.first, state.lower, state.variances
    variance: float = variances[which]
    for j in range(first, which):
        variance += lower[which, j] * lower[which, j] * variances[j]
    return variance


@firmware
def replace_loss(state: State, n: int, share: float, moment: float) -> None:
    """P with new states of a loss, of these variances, in place of the old; the others stay.

    Without any variance the states of a loss are unused.
    """
    first, lower, added = state.first, state.lower, state.added
    for k in range(first, LOSS_STATES):
        for i in range(LOSS_STATES, n):
            added[i] = lower[i, k]
        add(state, n, LOSS_STATES, state.variances[k])
    lower[:, :LOSS_STATES] = 0.0
    state.variances[SHARE] = share
    state.variances[MOMENT] = moment
    state.first = LOSS_STATES
    if share + moment > real(0.0, share):
        state.first = 0


@firmware
def clear_covariance(state: State) -> None:
    """P is zero."""
    state.lower[:] = 0.0
    state.variances[:] = 0.0
