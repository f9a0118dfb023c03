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
from firmware_model.law.supervision.echoes import known_output
from firmware_model.law.supervision.whitener import add_signal

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Table


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
    between: Annotated[float, "1", "s behind the first lag"]
    followed: Annotated[float, "1", "s behind the second lag"]
    previous_output: Annotated[float, "y", "w of the last tick"]
    delay: Annotated[FloatArray, "y", "ring of w on its way into d̂", (MAX_SHOWN_TICKS,)]
    fading: Annotated[biquad.State, "y", "state of G1 left by the losses and returns before"]
    previous_fading: Annotated[float, "y", "their missing output in the last tick"]
    fading_delay: Annotated[
        FloatArray, "y", "ring of this output on its way into d̂", (MAX_SHOWN_TICKS,)
    ]


@firmware
def loss_output(table: Table, state: layout.State) -> float:
    """Return w of this tick, driven by this tick's command."""
    w: float = output(table.estimator.channel_1, state.loss_model.channel_1, lost_command(state))
    return w


@firmware
def loss_shown(table: Table, state: layout.State) -> float:
    """Return w as contained in d̂ of this tick, late by bus and dead time."""
    if table.estimator.shown_ticks_1 > 0:
        w: float = state.loss_model.delay[state.estimator.shown_index_1]
        return w
    return loss_output(table, state)


@firmware
def fading_output(table: Table, state: layout.State) -> float:
    """Return the output that is still missing after the losses and returns before."""
    zero = real(0.0, state.command_1)
    fading: float = output(table.estimator.channel_1, state.loss_model.fading, zero)
    return fading


@firmware
def fading_shown(table: Table, state: layout.State) -> float:
    """Return ``fading_output`` as contained in d̂ of this tick, late by bus and dead time."""
    if table.estimator.shown_ticks_1 > 0:
        fading: float = state.loss_model.fading_delay[state.estimator.shown_index_1]
        return fading
    return fading_output(table, state)


@firmware
def missing_shown(table: Table, state: layout.State) -> float:
    """Return all that is known to be missing in the measurement of this tick."""
    missing: float = earlier_missing(table, state) + known_share(state) * loss_shown(table, state)
    return missing


@firmware
def earlier_missing(table: Table, state: layout.State) -> float:
    """Return the known missing output less the present loss: of earlier losses, and by echoes."""
    missing: float = fading_shown(table, state)
    if table.echoes.longest > 0:
        g1, g2 = table.estimator.channel_1, table.estimator.channel_2
        missing += known_output(table.echoes.actuator_1, g1, state.echoes.channel_1)
        missing += known_output(table.echoes.actuator_2, g2, state.echoes.channel_2)
    return missing


@firmware
def earlier_shown(table: Table, state: layout.State) -> float:
    """Return the change of the delayed w if the confirmed loss were one tick older."""
    zero = real(0.0, state.command_1)
    return output(table.estimator.channel_1, state.loss_model.earlier, zero)


@firmware
def known_share(state: layout.State) -> float:
    """The present estimate of s, 0..1."""
    return possible_share(state.loss_model.share + state.mismatch.theta[0])


@firmware
def possible_share(share: float) -> float:
    """Limit ``share`` to the inactive part of command 1, 0..1."""
    possible: float = min(max(share, real(0.0, share)), real(1.0, share))
    return possible


@firmware
def follow_share(constants: Constants, state: layout.State) -> None:
    """What F̂ gets of s, a tick later."""
    loss = state.loss_model
    loss.between += constants.follow * (known_share(state) - loss.between)
    loss.followed += constants.follow * (loss.between - loss.followed)


@firmware
def lost_command(state: layout.State) -> float:
    """The command with the lost share s: this tick's command, or zero before a known loss."""
    command: float = state.command_1
    if state.fault_state == CONFIRMED:
        return command
    return real(0.0, command)


@firmware
def advance_loss_model(table: Table, state: layout.State) -> None:
    """Advance w by this tick's command, computed or held."""
    loss = state.loss_model
    w = advance(table.estimator.channel_1, loss.channel_1, lost_command(state))
    loss.previous_output = w
    zero = real(0.0, w)
    advance(table.estimator.channel_1, loss.earlier, zero)
    fading = advance(table.estimator.channel_1, loss.fading, zero)
    loss.previous_fading = fading
    if table.estimator.shown_ticks_1 > 0:
        loss.delay[state.estimator.shown_index_1] = w
        loss.fading_delay[state.estimator.shown_index_1] = fading


@firmware
def take_over_candidate(table: Table, state: layout.State, share: float, sign: float) -> None:
    """The candidate becomes the loss (``sign`` 1) or the return (-1); what was lost before fades.

    Args:
        table: the constant table.
        state: changed in place.
        share: s from now on.
        sign: 1 or -1.
    """
    loss, test, g1 = state.loss_model, state.sequential_test, table.estimator.channel_1
    known, moment = known_share(state), state.mismatch.theta[1]
    shift = moment * output(g1, loss.earlier, real(0.0, share))
    for i in range(g1.n):
        for j in range(2):
            left = known * loss.channel_1.accumulators[i, j]
            loss.fading.accumulators[i, j] += left + moment * loss.earlier.accumulators[i, j]
            loss.channel_1.accumulators[i, j] = sign * test.channel_1.accumulators[i, j]
            loss.earlier.accumulators[i, j] = test.earlier.accumulators[i, j]
    white, w = state.mismatch.white, table.mismatch.whitener
    add_signal(w, white.fading, known, white.lost)
    add_signal(w, white.fading, moment, white.earlier)
    white.lost.memory[:] = white.earlier.memory[:] = 0.0
    add_signal(w, white.lost, sign, test.white)
    for i in range(table.estimator.shown_ticks_1):
        loss.fading_delay[i] += known * loss.delay[i] + shift
        loss.delay[i] = sign * test.delay[i]
    loss.previous_fading += known * loss.previous_output + shift
    loss.previous_output = sign * test.previous_output
    loss.share = share
    loss.between = loss.followed = possible_share(share)


@firmware
def clear_loss_model(state: layout.State) -> None:
    """Nothing is lost."""
    loss = state.loss_model
    loss.channel_1.accumulators[:] = 0.0
    loss.earlier.accumulators[:] = loss.fading.accumulators[:] = 0.0
    loss.delay[:] = loss.fading_delay[:] = 0.0
    loss.previous_fading = 0.0
    loss.share = loss.between = loss.followed = loss.previous_output = 0.0
