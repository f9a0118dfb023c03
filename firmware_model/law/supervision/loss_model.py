"""The model of d̂ after a loss: s w, with w the answer of G1 to the lost commands.

The thesis's (2.9) for a complete loss: the missing contribution of channel 1 to y. Once the channel
works again no more commands are lost, and w fades like the missing motion. A return, or the next
loss, leaves the motion missing so far in ``fading``: s then belongs to the newer commands alone.

At first s and the moment of the loss are known only roughly: ``mismatch`` learns both errors from
the following ticks. F̂ differentiates, so it gets s as two lags in a row follow it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.precision import real
from firmware_model.law.status import FaultState
from firmware_model.law.structs import MAX_SHOWN_TICKS, FloatArray, Struct
from firmware_model.law.supervision.covariance import MOMENT, SHARE
from firmware_model.law.supervision.echoes import FORCE, TORQUE, known_output
from firmware_model.law.supervision.whitener import add_signal

if TYPE_CHECKING:
    from firmware_model.law.core import estimator
    from firmware_model.law.layout import Table
    from firmware_model.law.supervision import echoes, likelihood_ratio, mismatch


CONFIRMED = int(FaultState.CONFIRMED)


class Constants(Struct):
    """Constants."""

    share_variance: Annotated[float, "1", "largest variance of s at the confirmation"]
    doubt: Annotated[float, "1", "variance of s at the confirmation, times its information"]
    least_doubt: Annotated[float, "1", "least variance of s, for a car with another G1"]
    moment: Annotated[float, "1", "deviation of the moment, as a part of the detection time"]
    follow: Annotated[float, "1", "part of the distance to s per tick of a lag"]


class State(Struct):
    """State."""

    channel_1: Annotated[biquad.State, "y", "state of G1 driven by the lost commands"]
    earlier: Annotated[
        biquad.State, "y", "state of G1 driven only by the last command before the loss"
    ]
    share: Annotated[float, "1", "s, the lost share of channel 1 at the confirmation"]
    between: Annotated[float, "1", "s after the first lag"]
    followed: Annotated[float, "1", "s after the second lag"]
    previous_output: Annotated[float, "y", "w of the last tick"]
    delay: Annotated[FloatArray, "y", "ring of w on its way into d̂", (MAX_SHOWN_TICKS,)]
    fading: Annotated[biquad.State, "y", "state of G1 left by the losses and returns before"]
    previous_fading: Annotated[float, "y", "their missing output in the last tick"]
    fading_delay: Annotated[
        FloatArray, "y", "ring of this output on its way into d̂", (MAX_SHOWN_TICKS,)
    ]


@firmware
def lost_command(fault_state: int, command_1: float) -> float:
    """The command with the lost share s: this tick's command, or zero before a known loss."""
    return command_1 if fault_state == CONFIRMED else real(0.0, command_1)


@firmware
def loss_output(table: Table, own: State, lost: float) -> float:
    """Return w of this tick, driven by this tick's ``lost`` command."""
    w: float = output(table.estimator.channel_1, own.channel_1, lost)
    return w


@firmware
def loss_shown(table: Table, own: State, model: estimator.State, lost: float) -> float:
    """Return w as contained in d̂ of this tick, late by bus and dead time."""
    if table.estimator.shown_ticks_1 > 0:
        w: float = own.delay[model.queue_1.index]
        return w
    return loss_output(table, own, lost)


@firmware
def fading_output(table: Table, own: State) -> float:
    """Return the output that is still missing after the losses and returns before."""
    fading: float = output(table.estimator.channel_1, own.fading, real(0.0, own.share))
    return fading


@firmware
def earlier_missing(table: Table, own: State, model: estimator.State, heard: echoes.State) -> float:
    """Return the known output missing in this tick's d̂ less the present loss.

    Of earlier losses, late by bus and dead time, and by echoes.
    """
    if table.estimator.shown_ticks_1 > 0:
        missing: float = own.fading_delay[model.queue_1.index]
    else:
        missing = fading_output(table, own)
    if table.echoes.longest > 0:
        g1, g2 = table.estimator.channel_1, table.estimator.channel_2
        missing += known_output(table.echoes.actuators[TORQUE], g1, heard.actuators[TORQUE])
        missing += known_output(table.echoes.actuators[FORCE], g2, heard.actuators[FORCE])
    return missing


@firmware
def missing_shown(
    table: Table,
    own: State,
    known: mismatch.State,
    model: estimator.State,
    heard: echoes.State,
    lost: float,
) -> float:
    """Return all that is known to be missing in the measurement of this tick."""
    missing: float = earlier_missing(table, own, model, heard)
    return missing + known_share(own, known) * loss_shown(table, own, model, lost)


@firmware
def earlier_shown(table: Table, own: State) -> float:
    """Return the change of the delayed w if the confirmed loss were one tick older."""
    return output(table.estimator.channel_1, own.earlier, real(0.0, own.share))


@firmware
def known_share(own: State, known: mismatch.State) -> float:
    """The present estimate of s, 0..1."""
    return possible_share(own.share + known.theta[SHARE])


@firmware
def possible_share(share: float) -> float:
    """Limit ``share`` to the inactive part of command 1, 0..1."""
    possible: float = min(max(share, real(0.0, share)), real(1.0, share))
    return possible


@firmware
def follow_share(constants: Constants, own: State, share: float) -> None:
    """What F̂ gets of ``share``, the present estimate of s, a tick later."""
    own.between += constants.follow * (share - own.between)
    own.followed += constants.follow * (own.between - own.followed)


@firmware
def advance_loss_model(table: Table, own: State, model: estimator.State, lost: float) -> None:
    """Advance w by this tick's ``lost`` command, computed or held."""
    w = advance(table.estimator.channel_1, own.channel_1, lost)
    own.previous_output = w
    zero = real(0.0, w)
    advance(table.estimator.channel_1, own.earlier, zero)
    fading = advance(table.estimator.channel_1, own.fading, zero)
    own.previous_fading = fading
    if table.estimator.shown_ticks_1 > 0:
        own.delay[model.queue_1.index] = w
        own.fading_delay[model.queue_1.index] = fading


@firmware
def take_over_candidate(
    table: Table,
    own: State,
    known: mismatch.State,
    test: likelihood_ratio.State,
    share: float,
    sign: float,
) -> None:
    """The candidate becomes the loss (``sign`` 1) or the return (-1); what was lost before fades.

    Args:
        table: the constant table.
        own: changed in place.
        known: of the car; changed in place.
        test: with the candidate.
        share: s from now on.
        sign: 1 or -1.
    """
    g1 = table.estimator.channel_1
    before, moment = known_share(own, known), known.theta[MOMENT]
    shift = moment * output(g1, own.earlier, real(0.0, share))
    for i in range(g1.n):
        for j in range(2):
            left = before * own.channel_1.accumulators[i, j]
            own.fading.accumulators[i, j] += left + moment * own.earlier.accumulators[i, j]
            own.channel_1.accumulators[i, j] = sign * test.channel_1.accumulators[i, j]
            own.earlier.accumulators[i, j] = test.earlier.accumulators[i, j]
    white, w = known.white, table.mismatch.whitener
    add_signal(w, white.fading, before, white.lost)
    add_signal(w, white.fading, moment, white.earlier)
    white.lost.memory[:] = white.earlier.memory[:] = 0.0
    add_signal(w, white.lost, sign, test.candidate.white)
    for i in range(table.estimator.shown_ticks_1):
        own.fading_delay[i] += before * own.delay[i] + shift
        own.delay[i] = sign * test.delay[i]
    own.previous_fading += before * own.previous_output + shift
    own.previous_output = sign * test.previous_output
    own.share = share
    own.between = own.followed = possible_share(share)


@firmware
def clear_loss_model(own: State) -> None:
    """Nothing is lost."""
    own.channel_1.accumulators[:] = 0.0
    own.earlier.accumulators[:] = own.fading.accumulators[:] = 0.0
    own.delay[:] = own.fading_delay[:] = 0.0
    own.previous_fading = 0.0
    own.share = own.between = own.followed = own.previous_output = 0.0
