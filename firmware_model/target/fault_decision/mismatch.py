"""Cars that are not the model: what they make of d̂, learnt tick by tick.

A car whose mass, tires, speed or actuators are not the model's shows d̂ = (G1 - G1') u1 without a
fault. To first order in its differences that is a sum

    d̂ = Σ θ_i x_i,   x_i = (G1_i - G1) u1,

where G1_i is the model of another car along the i-th principal direction of the box of cars that
the design allows for, scaled to one box (``design.mismatch``). A Kalman filter learns θ, which
starts at zero and wanders about it slowly,

    θ⁺ = φ θ + ...,  covariance P0 at rest,

from d̂ itself. What a loss would show is put through the same gains (``sequential_test``), so only
the part of it that no other car explains counts as evidence (Willsky and Jones, IEEE Trans. Autom.
Control 21 (1976) 108).

What other cars show beyond the first order is a remainder that changes as slowly as the car does:
one more θ, whose x is 1. Both wander only where the car moves: the steady state of a bend is the
same for any time, so what d̂ is there is soon known, and a loss is told from it at once. The measure
of motion is the fading largest change of the x_i, M, against their fading largest extent: the
remainder's variance is a share of the first, and θ wanders at the ratio of both. A model that is
trusted has no x.
"""

from __future__ import annotations

import math

from firmware_model.compiled import firmware
from firmware_model.target.fault_decision import covariance
from firmware_model.target.fault_decision.covariance import (
    SIZES,
    clear_covariance,
    fade,
    grow,
    measure,
)
from firmware_model.target.filters import biquad
from firmware_model.target.filters.biquad import advance, output, settle
from firmware_model.target.precision import real
from firmware_model.target.structs import Field, Record

CONSTANTS = (
    Field("cars", "1", "principal directions in use", "int32"),
    Field("n", "1", "these and the remainder; 0: the model is trusted", "int32"),
    Field("car_1", "y/u1", "G1 of the car along the first direction", biquad.CONSTANTS),
    Field("car_2", "y/u1", "likewise the second", biquad.CONSTANTS),
    Field("car_3", "y/u1", "likewise the third", biquad.CONSTANTS),
    Field("scale", "1", "from one of these cars to the end of the box"),
    Field("prior", "1", "P0, variance of each θ before anything is known; of the remainder 1"),
    Field("forgetting", "1", "1 - φ of each θ where the car moves", shape=SIZES),
    Field("growth", "1", "1 - φ², times the variance of θ", shape=SIZES),
    Field("motion", "1", "(time constant of the remainder/tick)², from changes to extents"),
    Field("beyond", "1", "variance of the remainder, as a share of M"),
    Field("rule", "1", "the same for what F1's discretisation leaves, of the change of G1 u1"),
    Field("white", "1", "share of the remainder's variance that differs from tick to tick"),
    Field("fading", "1", "what a tick leaves of M and of the largest extent"),
    Field("noise", "y²", "variance of the whitened noise of a tick"),
    Field("colour", "1", "a of the noise, n(k) = a n(k-1) + white"),
)
STATE = (
    Field("car_1", "y", "its state", biquad.STATE),
    Field("car_2", "y", "its state", biquad.STATE),
    Field("car_3", "y", "its state", biquad.STATE),
    Field("x", "y", "x of the last tick", shape=SIZES),
    Field("regressor", "y", "x of this tick, whitened", shape=SIZES),
    Field("theta", "1", "θ", shape=SIZES),
    Field("covariance", "1", "P", covariance.STATE),
    Field("gain", "1/y", "of the last update of θ", shape=SIZES),
    Field("memory", "1", "φ, what that tick left of each θ", shape=SIZES),
    Field("extent", "y²", "fading largest Σ x²"),
    Field("change", "y²", "M, fading largest Σ (time constant · dx/dt)²"),
    Field("remainder", "y²", "variance of the remainder"),
    Field("previous_model_output", "y", "G1 u1 of the last tick"),
    Field("previous_residual", "y", "d̂ of the last tick, less the known loss"),
    Field("variance", "y²", "S, of the innovation"),
)


@firmware
def predict_mismatch(constants: Record, state: Record, command_1: float, model_1: float) -> None:
    """x of this tick, and its part in the variance of the noise.

    Args:
        constants: of this module.
        state: of this module; changed in place.
        command_1: the command that acts, as d̂ of this tick shows it.
        model_1: G1 u1 likewise.
    """
    a, x, previous = constants.colour, state.regressor, state.x
    extent = change = real(0.0, model_1)
    for i in range(constants.cars):
        if i == 0:
            other = output(constants.car_1, state.car_1, command_1)
        elif i == 1:
            other = output(constants.car_2, state.car_2, command_1)
        else:
            other = output(constants.car_3, state.car_3, command_1)
        now = (other - model_1) * constants.scale
        x[i] = now - a * previous[i]
        moved = now - previous[i]
        previous[i] = now
        extent += now * now
        change += moved * moved
    if constants.n > 0:
        x[constants.n - 1] = real(1.0, model_1) - a
    moved = model_1 - state.previous_model_output
    state.previous_model_output = model_1
    fading, motion = constants.fading, constants.motion
    state.extent = max(fading * state.extent, finite(extent))
    state.change = max(fading * state.change, finite(motion * change))
    rule = finite(constants.rule * moved * moved)
    state.remainder = max(fading * state.remainder, constants.beyond * state.change, rule)


@firmware
def finite(value: float) -> float:
    """``value``, or zero where it is not finite: an overflow must not stay in a memory."""
    return value if math.isfinite(value) else real(0.0, value)


@firmware
def innovation(constants: Record, state: Record, residual: float) -> float:
    """What is new in ``residual``, d̂ less the known loss; θ and P learn from it.

    Leaves the gain in ``state.gain`` and the innovation's variance in ``state.variance``.
    """
    n, x, gain = constants.n, state.regressor, state.gain
    theta, memory = state.theta, state.memory
    new: float = residual - constants.colour * state.previous_residual
    state.previous_residual = residual
    for i in range(n):
        new -= x[i] * theta[i]
    noise = constants.noise + constants.white * state.remainder
    state.variance = measure(state.covariance, n, x, noise, gain)
    one = real(1.0, new)
    wander = min(state.change / state.extent, one) if state.extent > real(0.0, new) else one
    for i in range(n):
        memory[i] = one - wander * constants.forgetting[i]
        theta[i] = memory[i] * (theta[i] + gain[i] * new)
    fade(state.covariance, n, memory)
    for i in range(n):
        growth = state.remainder if i == n - 1 else wander
        grow(state.covariance, i, constants.growth[i] * growth)
    if not (math.isfinite(new) and math.isfinite(state.variance)):
        clear_mismatch(constants, state)
    return new


@firmware
def advance_cars(constants: Record, state: Record, command_1: float) -> None:
    """Advance the other cars by the command that acts."""
    if constants.cars > 0:
        advance(constants.car_1, state.car_1, command_1)
    if constants.cars > 1:
        advance(constants.car_2, state.car_2, command_1)
    if constants.cars > 2:
        advance(constants.car_3, state.car_3, command_1)


@firmware
def clear_mismatch(constants: Record, state: Record) -> None:
    """Nothing is known of the car, which is at rest."""
    state.car_1.accumulators[:] = 0.0
    state.car_2.accumulators[:] = 0.0
    state.car_3.accumulators[:] = 0.0
    state.x[:] = 0.0
    state.theta[:] = 0.0
    clear_covariance(state.covariance)
    for i in range(constants.cars):
        state.covariance.variances[i] = constants.prior
    state.extent = state.change = state.remainder = 0.0
    state.previous_model_output = 0.0
    state.previous_residual = 0.0


@firmware
def settle_mismatch(constants: Record, state: Record, command_1: float, model_1: float) -> None:
    """The steady state for a constant command; nothing is known of the car."""
    clear_mismatch(constants, state)
    settle(constants.car_1, state.car_1, command_1)
    settle(constants.car_2, state.car_2, command_1)
    settle(constants.car_3, state.car_3, command_1)
    predict_mismatch(constants, state, command_1, model_1)
    state.change = state.remainder = 0.0  # it came there long ago
