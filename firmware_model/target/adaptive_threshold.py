"""How much d̂ is too much: a threshold for the model, and a share for the car that is not the model.

A car whose mass, tires or speed are not the model's gives some d̂ = (G1 - G1') u1, a share of what
channel 1 does, for as long as it does it. A loss gives all of it, but not at once: d̂ grows with the
square of time. A fixed threshold above the first finds the second late. So the threshold adapts to
what the model makes of the commands (a threshold selector: Emami-Naeini, Akhter and Rock, IEEE
Trans. Autom. Control 33 (1988) 1106), and d̂ is too much in one of two ways:

    by size      |d̂| > threshold + share · most,       most = largest |G1 u1| of late
    by change    |Hd̂| > threshold + share · most of H,  the same of H G1 u1

H = (z - 1)/(z - p) forgets what stays: of a steady bend it leaves no d̂ of another car and nothing
of G1 u1, so a loss there is seen at once, however large the share is. In a transient it is seen as
soon as it is more than other cars could show. "Of late" fades, as d̂ of another car does.

With a share of zero the model is trusted, and only the size of d̂ counts.
"""

from __future__ import annotations

import math

from firmware_model.compiled import firmware
from firmware_model.target.layout import FaultState, Record

CONFIRMED = int(FaultState.CONFIRMED)


@firmware
def watch(table: Record, state: Record, estimate: float, expected: float) -> None:
    """Take in this tick's d̂ and what the model makes of the commands that act: G1 u1.

    And G2 u2 where that is the compensation's: it is a share of both that another car shows.
    """
    memory = table.change_memory
    change = memory * state.change + (estimate - state.estimate_before)
    change_expected = memory * state.change_expected + (expected - state.expected_before)
    state.change = finite(change)
    state.change_expected = finite(change_expected)
    state.estimate_before = finite(estimate)
    state.expected_before = finite(expected)
    fading = table.most_memory
    state.most = max(fading * state.most, abs(state.expected_before))
    state.most_change = max(fading * state.most_change, abs(state.change_expected))
    if state.fault_state == CONFIRMED:  # what a loss does, or its end, is no reason for another
        state.most_change = max(state.most_change, abs(state.change))


@firmware
def too_much(table: Record, state: Record, estimate: float) -> bool:
    """Whether d̂ is more than a channel that works explains."""
    share = table.model_share
    by_size = abs(estimate) > table.threshold + share * state.most
    by_change = abs(state.change) > table.threshold + share * state.most_change
    return bool(by_size or (share > 0.0 and by_change))


@firmware
def would_show(table: Record, state: Record, lost: float) -> bool:
    """Whether ``lost``, what a lost channel 1 would have added to y by now, is too much d̂.

    Of the change that it began with, ``clear_ratio`` is counted: H forgets some before it is there.
    """
    share, size = table.model_share, abs(lost)
    by_size = size > table.threshold + share * state.most
    by_change = size * table.clear_ratio > table.threshold + share * state.most_change
    return bool(by_size or (share > 0.0 and by_change))


@firmware
def share_shown(table: Record, state: Record) -> float:
    """The share of what channel 1 does that explains this tick's d̂: the least not too much."""
    shown = 0.0
    size, change = abs(state.estimate_before), abs(state.change)
    if size > table.threshold and state.most > 0.0:
        shown = (size - table.threshold) / state.most
    if change > table.threshold and state.most_change > 0.0:
        shown = max(shown, (change - table.threshold) / state.most_change)
    return shown


@firmware
def begin_watching(state: Record, expected: float) -> None:
    """Nothing seen yet; channel 1 at work adds ``expected``, as it has for long."""
    state.change = state.change_expected = state.most_change = 0.0
    state.estimate_before = state.offset = 0.0
    state.expected_before = expected
    state.most = abs(expected)


@firmware
def finite(value: float) -> float:
    """``value``, or zero: a number that is lost must not stay lost."""
    return value if math.isfinite(value) else 0.0
