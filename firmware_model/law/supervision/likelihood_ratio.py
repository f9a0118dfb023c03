"""The sequential test for the moment of a loss, or of the return, of channel 1.

The effect of a loss is known except for moment and share: after the loss d̂ = s w, with w the
answer of G1 to the commands since. So one candidate runs along, restarted whenever the evidence
contradicts the candidate, and the log-likelihood ratio grows with every tick (Page's cumulative sum
of a known signature: Basseville and Nikiforov, Detection of Abrupt Changes, 1993, 7.2.4):

    g⁺ = g + (f ν - ½ f²)/S

with ν the innovation of d̂ (``mismatch``), S its variance, and f the effect of a loss of ``share``
on ν. So g is the predicted evidence of a ``candidate`` whose size is given. A g below -1 rejects
the moment, and the candidate restarts at this tick. An f that fades before a decision
restarts the candidate too, because no more evidence can follow. The chance that a healthy car takes
one candidate beyond h is e^-h at most (Wald), and there is at most one a tick: so h is the
logarithm of the ticks between two false alarms, whatever the drive, and needs no tuning. A takeover
begins few candidates in the life of a controller, so a smaller h confirms these candidates.

The test for the return of a lost channel is the same with the opposite sign.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.core.estimator import arriving, waiting
from firmware_model.law.precision import real
from firmware_model.law.structs import MAX_SHOWN_TICKS, FloatArray, Struct
from firmware_model.law.supervision import candidate
from firmware_model.law.supervision.candidate import start, take_in

if TYPE_CHECKING:
    from firmware_model.law.core import estimator
    from firmware_model.law.layout import Table
    from firmware_model.law.supervision import mismatch


class Constants(Struct):
    """Constants."""

    share: Annotated[float, "1", "tested lost share of channel 1"]
    restart: Annotated[float, "1", "log-likelihood ratio of a restart"]
    freshness: Annotated[
        float, "1", "least growth of information per doubled age; else the candidate ends"
    ]
    needed: Annotated[float, "1", "information of a decision"]
    promising: Annotated[float, "1", "evidence that keeps an old candidate"]
    deviations: Annotated[float, "1", "deviations by which a share above 1 must exceed 1"]


class State(Struct):
    """State."""

    channel_1: Annotated[biquad.State, "y", "state of G1 driven by the commands since the start"]
    earlier: Annotated[
        biquad.State, "y", "state of G1 driven only by the last command before the start"
    ]
    delay: Annotated[FloatArray, "y", "ring of w on its way into d̂", (MAX_SHOWN_TICKS,)]
    previous_output: Annotated[float, "y", "w of the last tick"]
    candidate: Annotated[candidate.State, "1", "fit of w to d̂; g is the predicted evidence"]
    half_age: Annotated[float, "tick", "age at the last check of growth"]
    half_information: Annotated[float, "1", "information at the last check of growth"]
    half_predicted: Annotated[float, "1", "g at the last check of growth"]
    of_takeover: Annotated[int, "1", "1: the candidate began in a takeover"]


@firmware
def candidate_shown(table: Table, test: State, model: estimator.State, command_1: float) -> float:
    """Return w as contained in d̂ of this tick, late by bus and dead time."""
    if table.estimator.shown_ticks_1 > 0:
        w: float = test.delay[model.queue_1.index]
        return w
    return output(table.estimator.channel_1, test.channel_1, command_1)


@firmware
def update_test(
    table: Table, test: State, known: mismatch.State, shown: float, innovation: float, share: float
) -> bool:
    """Take in a tick, and return whether the candidate ends.

    Args:
        table: the constant table.
        test: changed in place.
        known: of the car, of this tick.
        shown: w in d̂ of this tick.
        innovation: ν.
        share: above 0 a loss is looked for, below 0 a return.
    """
    own, limits = test.candidate, table.hypotheses.torque_lost
    own.size_now = share
    take_in(table.mismatch, known, own, limits, shown, innovation)
    constants, none = table.sequential_test, real(0.0, share)
    suspected = share > none and own.predicted > constants.promising
    stale = is_stale(constants, test) and not suspected
    return stale or not own.predicted > constants.restart


@firmware
def is_stale(constants: Constants, test: State) -> bool:
    """Whether a candidate of doubled age has gained hardly any information, or lost evidence.

    Neither a good part of the present information, nor enough for a decision; or the later half of
    its age alone rejects the onset.
    """
    own, two = test.candidate, real(2.0, test.half_age)
    if own.age < two * max(test.half_age, two):
        return False
    learnt, gained = own.information - test.half_information, own.predicted - test.half_predicted
    fresh = min(constants.freshness * test.half_information, constants.needed)
    test.half_age = own.age
    test.half_information = own.information
    test.half_predicted = own.predicted
    stale: bool = learnt < fresh or not gained > constants.restart
    return stale


@firmware
def start_candidate(
    table: Table, test: State, model: estimator.State, command_1: float, of_takeover: int
) -> None:
    """Restart: all past commands acted; the commands on the way are lost."""
    constants = table.estimator
    g1, shown = constants.channel_1, constants.shown_ticks_1
    test.channel_1.accumulators[:] = 0.0
    test.earlier.accumulators[:] = 0.0
    start(test.candidate)
    test.previous_output = 0.0
    test.half_age = test.half_information = test.half_predicted = 0.0
    test.of_takeover = of_takeover
    for i in range(shown):
        command = waiting(model.queue_1, shown, shown - i, command_1)
        w = output(g1, test.channel_1, command)
        test.delay[(model.queue_1.index + i) % shown] = w
        test.previous_output = w
        advance(g1, test.channel_1, command)
    # the last acting command has left the queue and hardly differs from the next
    before = arriving(model.queue_1, shown, command_1)
    advance(g1, test.earlier, before)


@firmware
def advance_candidate(table: Table, test: State, model: estimator.State, command_1: float) -> None:
    """Advance w by this tick's command, computed or held."""
    w = advance(table.estimator.channel_1, test.channel_1, command_1)
    test.previous_output = w
    advance(table.estimator.channel_1, test.earlier, real(0.0, w))
    if table.estimator.shown_ticks_1 > 0:
        test.delay[model.queue_1.index] = w


@firmware
def forget_candidate(table: Table, test: State, known: mismatch.State, share: float) -> None:
    """Remove the effect of ``share`` of w from θ: θ took the loss for another car."""
    for i in range(table.mismatch.n):
        known.theta[i] -= share * test.candidate.explained[i]


@firmware
def lost_share(constants: Constants, own: candidate.State) -> float:
    """The share of channel 1 that explains ``innovation`` best, by least squares, 0 or above.

    Above 1 only if necessary: channel 1 then moves this car more than the model.
    """
    zero, one = real(0.0, own.evidence), real(1.0, own.evidence)
    if not own.information > zero:
        return one
    best = own.correlation / own.information
    least = best - constants.deviations / np.sqrt(own.information)
    share: float = min(max(best, zero), max(one, least))
    return share
