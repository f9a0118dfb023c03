"""The difference between a car and the model, learnt from d̂ tick by tick, and the innovation.

To first order in its differences a car without a fault shows

    d̂ = Σ θ_i x_i

with x_i the effect of the cars along the principal directions of the box (``other_cars``). A Kalman
filter learns θ; θ starts at zero and wanders slowly around zero,

    θ⁺ = φ θ + ...,  covariance P0 at rest,

from d̂ itself. The signature of a loss passes the same gains (``likelihood_ratio``), so only the
part that no other car explains counts as evidence (Willsky and Jones, IEEE Trans. Autom. Control 21
(1976) 108).

After a confirmed loss two more states learn the error of the share (x is the lost w) and the error
of the moment in ticks (x is the effect of one more command): share and moment are only roughly
known at first.

The effect of other cars beyond the first order is a remainder that changes as slowly as the car
moves: one more θ with x = 1. Both wander only while the car moves: the steady state of a bend is
constant, so the filter soon knows the steady d̂ and distinguishes a loss at once. The measure of
motion is the fading largest change of the x_i, M, against their fading largest extent: the
remainder's variance is a share of the first, and θ wanders at the ratio of both. The remainder is
of second order, so the variance grows with the square of the mean θ² that is still possible: a car
close to the model leaves little remainder. A trusted model has no x.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import FloatArray, Records, Struct
from firmware_model.law.supervision import whitener
from firmware_model.law.supervision.covariance import (
    LOSS_STATES,
    MAX_DIRECTIONS,
    MAX_STATES,
    MOMENT,
    SHARE,
    SIZES,
    State as CovarianceState,
    clear_covariance,
    fade,
    grow,
    measure,
    replace_loss,
    variance_of,
)
from firmware_model.law.supervision.whitener import settle_whitener, whiten

if TYPE_CHECKING:
    from firmware_model.law.layout import Table


class Constants(Struct):
    """Constants."""

    n: Annotated[
        int, "1", "states: share and moment of a loss, other cars, the remainder", (0, MAX_STATES)
    ]
    prior: Annotated[float, "1", "P0, initial variance of each θ; of the remainder 1"]
    forgetting: Annotated[FloatArray, "1", "1 - φ of each θ where the car moves", SIZES]
    growth: Annotated[FloatArray, "1", "1 - φ², times the variance of θ", SIZES]
    motion: Annotated[float, "1", "(time constant of the remainder/tick)², from changes to extents"]
    beyond: Annotated[
        float, "1", "variance of the remainder, as a share of M, for cars all over the box"
    ]
    rule: Annotated[
        float, "1", "variance of the error of F1's rule, as a share of the change of G1 u1 + G2 u2"
    ]
    white: Annotated[float, "1", "white share of the remainder's variance"]
    fading: Annotated[float, "1", "factor per tick of M and of the largest extent"]
    noise: Annotated[float, "y²", "variance of the whitened noise of a tick"]
    whitener: Annotated[whitener.Constants, "1", "W"]
    remainder_shown: Annotated[float, "1", "x of the remainder: size of W for its time constant"]


class White(Struct):
    """The memories of W, one for each signal."""

    lost: Annotated[whitener.State, "y", "w of a confirmed loss"]
    earlier: Annotated[whitener.State, "y", "change of w with the moment of the loss"]
    cars: Annotated[Records[whitener.State], "y", "x of each other car", (MAX_DIRECTIONS,)]
    d_hat: Annotated[whitener.State, "y", "d̂"]
    sensor_error: Annotated[whitener.State, "y", "known error of the sensor"]
    fading: Annotated[whitener.State, "y", "missing output left by earlier losses and returns"]


class State(Struct):
    """State."""

    x: Annotated[FloatArray, "y", "x of the last tick", SIZES]
    regressor: Annotated[FloatArray, "y", "x of this tick, whitened", SIZES]
    white: Annotated[White, "y", "memories of W"]
    theta: Annotated[FloatArray, "1", "θ", SIZES]
    covariance: Annotated[CovarianceState, "1", "P"]
    gain: Annotated[FloatArray, "1/y", "gain of the last update of θ", SIZES]
    memory: Annotated[FloatArray, "1", "φ of each θ in the last update", SIZES]
    extent: Annotated[float, "y²", "fading largest Σ x²"]
    change: Annotated[float, "y²", "M, fading largest Σ (time constant · dx/dt)²"]
    rule: Annotated[float, "y²", "fading part due to F1's rule or to the initial error"]
    remainder: Annotated[float, "y²", "variance of the remainder"]
    previous_model_output: Annotated[float, "y", "G1 u1 + G2 u2 of the last tick"]
    previous_residual: Annotated[float, "y", "d̂ of the last tick, less the known loss"]
    variance: Annotated[float, "y²", "S, of the innovation"]


@firmware
def predict_mismatch(
    table: Table, known: State, shown: FloatArray, model_output: float, lost: float, earlier: float
) -> None:
    """Compute x of this tick and the part of x in the noise variance.

    Args:
        table: the constant table.
        known: changed in place.
        shown: x_i of this tick, of ``other_cars``.
        model_output: G1 u1 + G2 u2 as contained in d̂.
        lost: w of a confirmed loss as contained in d̂; 0 without loss.
        earlier: the change of w if the loss were one tick older.
    """
    constants = table.mismatch
    x, previous, w, white = known.regressor, known.x, constants.whitener, known.white
    extent = change = real(0.0, model_output)
    if known.covariance.first == 0:
        x[SHARE] = whiten(w, white.lost, lost)
        x[MOMENT] = whiten(w, white.earlier, earlier)
    previous[SHARE], previous[MOMENT] = lost, earlier
    for i in range(table.other_cars.n):
        k, now = LOSS_STATES + i, shown[i]
        moved = now - previous[k]
        previous[k] = now
        extent += now * now
        change += moved * moved
        x[k] = whiten(w, white.cars[i], now)
    if constants.n > LOSS_STATES:
        x[constants.n - 1] = constants.remainder_shown
    moved = model_output - known.previous_model_output
    known.previous_model_output = model_output
    fading, motion = constants.fading, constants.motion
    known.extent = max(fading * known.extent, finite(extent))
    known.change = max(fading * known.change, finite(motion * change))
    beyond, rule = constants.beyond * known.change, finite(constants.rule * moved * moved)
    known.rule = max(fading * known.rule, rule)
    off = difference(table, known)
    known.remainder = max(beyond * off * off, known.rule)


@firmware
def difference(table: Table, state: State) -> float:
    """Mean square of θ for this car relative to the box; 1 at most."""
    constants, cars = table.mismatch, table.other_cars.n
    zero, one = real(0.0, constants.prior), real(1.0, constants.prior)
    squares = box = zero
    for i in range(LOSS_STATES, LOSS_STATES + cars):
        squares += variance_of(state.covariance, i) + state.theta[i] * state.theta[i]
        box += constants.prior
    return min(squares / box, one) if box > zero else one


@firmware
def finite(value: float) -> float:
    """Return ``value``, or zero if not finite: an overflow must not stay in a memory."""
    return value if math.isfinite(value) else real(0.0, value)


@firmware
def innovation(
    constants: Constants, state: State, residual: float, known: float, fading: float, share: float
) -> float:
    """Return the innovation of this tick; θ and P are updated.

    Leaves the gain in ``state.gain`` and the innovation's variance in ``state.variance``.

    Args:
        constants: of this module.
        state: of this module, after ``predict_mismatch``; changed in place.
        residual: d̂.
        known: the part of d̂ that a known sensor error hides.
        fading: the part of d̂ left by earlier losses and returns.
        share: of the known loss in d̂.
    """
    first, n, x, gain = state.covariance.first, constants.n, state.regressor, state.gain
    theta, memory = state.theta, state.memory
    w = constants.whitener
    shown = whiten(w, state.white.d_hat, residual)
    hidden = whiten(w, state.white.sensor_error, known)
    left = whiten(w, state.white.fading, fading)
    new: float = shown + hidden - left - share * x[SHARE]
    state.previous_residual = residual + known - fading - share * state.x[SHARE]
    for i in range(first, n):
        new -= x[i] * theta[i]
    noise = constants.noise + constants.white * state.remainder
    state.variance = measure(state.covariance, n, x, noise, gain)
    one = real(1.0, new)
    wander = min(state.change / state.extent, one) if state.extent > real(0.0, new) else one
    for i in range(first, n):
        memory[i] = one - wander * constants.forgetting[i]
        theta[i] = memory[i] * (theta[i] + gain[i] * new)
    fade(state.covariance, n, memory)
    for i in range(LOSS_STATES, n):
        growth = state.remainder if i == n - 1 else wander
        grow(state.covariance, n, i, constants.growth[i] * growth)
    if not (math.isfinite(new) and math.isfinite(state.variance)):
        clear_mismatch(constants, state)
    return new


@firmware
def forget_car(constants: Constants, state: State) -> None:
    """No knowledge of θ; the car may move."""
    state.theta[:] = 0.0
    clear_covariance(state.covariance)
    for i in range(LOSS_STATES, constants.n - 1):
        state.covariance.variances[i] = constants.prior


@firmware
def clear_mismatch(constants: Constants, state: State) -> None:
    """Forget the car: no knowledge of θ, car at rest."""
    forget_car(constants, state)
    state.x[:] = 0.0
    state.extent = state.change = state.rule = state.remainder = 0.0
    state.previous_model_output = 0.0
    state.previous_residual = 0.0
    white = state.white
    white.lost.memory[:] = white.earlier.memory[:] = 0.0
    for i in range(MAX_DIRECTIONS):
        white.cars[i].memory[:] = 0.0
    white.d_hat.memory[:] = white.sensor_error.memory[:] = white.fading.memory[:] = 0.0


@firmware
def settle_mismatch(table: Table, known: State, shown: FloatArray, model_output: float) -> None:
    """The steady state that ``other_cars`` shows; nothing is known of the car."""
    zero = real(0.0, model_output)
    clear_mismatch(table.mismatch, known)
    learn_loss(table.mismatch, known, zero, zero)
    predict_mismatch(table, known, shown, model_output, zero, zero)
    for i in range(MAX_DIRECTIONS):
        settle_whitener(table.mismatch.whitener, known.white.cars[i], shown[i])
    known.change = known.rule = known.remainder = 0.0  # the car came there long ago


@firmware
def doubt_motion(constants: Constants, state: State, variance: float) -> None:
    """Allow an initial error of y with this ``variance`` that fades with time."""
    state.rule = variance
    if constants.n > LOSS_STATES:
        state.covariance.variances[constants.n - 1] = variance


@firmware
def learn_loss(constants: Constants, state: State, share: float, moment: float) -> None:
    """From now on learn how far share and moment of a loss are off; nothing, with zeros.

    Args:
        constants: of this module.
        state: of this module; changed in place.
        share: variance of the share.
        moment: variance of the moment, in ticks².
    """
    state.theta[:LOSS_STATES] = state.regressor[:LOSS_STATES] = 0.0
    replace_loss(state.covariance, constants.n, share, moment)
