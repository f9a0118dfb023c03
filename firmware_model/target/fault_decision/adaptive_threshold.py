"""The threshold of d̂: a constant part, and a share of what the plant model makes of the commands.

A car whose mass, tires or speed are not the model's shows some d̂ = (G1 - G1') u1, a share of what
channel 1 does, for as long as it does it. A loss shows all of it, but not at once: d̂ grows with the
square of time. A fixed threshold above the first detects the second late. So the threshold adapts
to the output of the model (a threshold selector: Emami-Naeini, Akhter and Rock, IEEE Trans. Autom.
Control 33 (1988) 1106), and d̂ exceeds it in one of two ways:

    in size      |d̂| > threshold + share · peak,         peak = fading maximum of |G1 u1|
    in change    |Hd̂| > threshold + share · peak of H,   the same of H G1 u1

H = (z - 1)/(z - p) is a high-pass: in a steady bend it leaves nothing of the d̂ that another car
shows and nothing of G1 u1, so a loss there is detected at once, however large the share. In a
transient it is detected as soon as it is more than other cars could show. The peaks fade as the d̂
of another car does.

With a share of zero the model is trusted, and only the size of d̂ counts.
"""

from __future__ import annotations

import math

from firmware_model.compiled import firmware
from firmware_model.target.precision import real
from firmware_model.target.structs import Field, Record

CONSTANTS = (
    Field("threshold", "y", "constant part of the threshold"),
    Field("model_share", "1", "share of G1 u1 that another car may show as d̂; 0: trust the model"),
    Field("change_memory", "1", "p of the high-pass H"),
    Field("peak_memory", "1", "what a tick leaves of the peaks"),
    Field("clear_ratio", "1", "part of a loss that has to exceed the threshold to be missed"),
)
STATE = (
    Field("change", "y", "H d̂"),
    Field("model_change", "y", "H G1 u1"),
    Field("previous_estimate", "y", "d̂ of the last tick"),
    Field("previous_model_output", "y", "G1 u1 of the last tick"),
    Field("peak_model_output", "y", "fading maximum of |G1 u1|"),
    Field("peak_model_change", "y", "fading maximum of |H G1 u1|"),
)


@firmware
def adapt(
    constants: Record, state: Record, estimate: float, model_output: float, confirmed: bool
) -> None:
    """Take in d̂ and G1 u1 of this tick, G2 u2 included where that compensates.

    Args:
        constants: of this module.
        state: of this module; changed in place.
        estimate: d̂.
        model_output: what the commands that act add to y by the model.
        confirmed: whether a loss is: what that does, or its end, is no evidence of another.
    """
    memory, fading = constants.change_memory, constants.peak_memory
    change = finite(memory * state.change + (estimate - state.previous_estimate))
    model_change = finite(
        memory * state.model_change + (model_output - state.previous_model_output)
    )
    peak_change = max(fading * state.peak_model_change, abs(model_change))
    state.previous_estimate = finite(estimate)
    state.previous_model_output = finite(model_output)
    state.peak_model_output = max(fading * state.peak_model_output, abs(finite(model_output)))
    state.peak_model_change = max(peak_change, abs(change)) if confirmed else peak_change
    state.change = change
    state.model_change = model_change


@firmware
def exceeds_threshold(constants: Record, state: Record, estimate: float) -> bool:
    """Whether d̂ is more than a plant whose channels work would show."""
    share, threshold = constants.model_share, constants.threshold
    in_size = abs(estimate) > threshold + share * state.peak_model_output
    in_change = abs(state.change) > threshold + share * state.peak_model_change
    return bool(in_size or (share > 0.0 and in_change))


@firmware
def would_exceed_threshold(constants: Record, state: Record, lost: float) -> bool:
    """Whether d̂ would exceed the threshold, were channel 1 dead and ``lost`` its part of y.

    Only ``clear_ratio`` of it counts as change: H has forgotten some before it has grown so large.
    """
    share, threshold, size = constants.model_share, constants.threshold, abs(lost)
    in_size = size > threshold + share * state.peak_model_output
    in_change = size * constants.clear_ratio > threshold + share * state.peak_model_change
    return bool(in_size or (share > 0.0 and in_change))


@firmware
def least_model_share(constants: Record, state: Record) -> float:
    """The least ``model_share`` with which this tick's d̂ does not exceed the threshold."""
    size, change = abs(state.previous_estimate), abs(state.change)
    threshold = constants.threshold
    share = real(0.0, size)
    if size > threshold and state.peak_model_output > 0.0:
        share = (size - threshold) / state.peak_model_output
    if change > threshold and state.peak_model_change > 0.0:
        share = max(share, (change - threshold) / state.peak_model_change)
    return share


@firmware
def settle_threshold(state: Record, model_output: float) -> None:
    """The steady state of a healthy plant to which channel 1 adds ``model_output``."""
    state.change = state.model_change = state.peak_model_change = 0.0
    state.previous_estimate = 0.0
    state.previous_model_output = model_output
    state.peak_model_output = abs(model_output)


@firmware
def finite(value: float) -> float:
    """``value``, or zero where it is not finite: an overflow must not stay in a memory."""
    return value if math.isfinite(value) else real(0.0, value)
