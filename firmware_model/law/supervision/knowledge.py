"""What is known of the car and of its actuators, in a form that outlives a restart.

``save`` writes the knowledge into ``saved``; the node keeps those bytes. After power-up the
node puts the bytes back, and the first tick with both inputs begins with them. So a known loss is
compensated from the first tick, and no test has to find the loss again. The end of standby is such
a begin too.

Known are the lost share of channel 1, the error of the sensor, θ of the car, and the verdict. The
variance of θ begins anew: load and tires may have changed. Nothing is known of the motion of the
car and of commands on their way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core.biquad import settle
from firmware_model.law.precision import real
from firmware_model.law.structs import FloatArray, Struct
from firmware_model.law.supervision.covariance import MAX_STATES, SHARE, SIZES, variance_of
from firmware_model.law.supervision.loss_model import CONFIRMED, known_share
from firmware_model.law.supervision.mismatch import learn_loss
from firmware_model.law.supervision.verdict import ANOTHER_CAR, BOTH_LOST, SENSOR_FROZEN
from firmware_model.law.supervision.whitener import settle_whitener

if TYPE_CHECKING:
    from firmware_model.law import layout
    from firmware_model.law.layout import Supervision, Table
    from firmware_model.law.supervision import loss_model, mismatch, verdict


class Saved(Struct):
    """The saved state; neither precision has padding."""

    crc: Annotated[int, "1", "CRC-32 of all bytes after this number"]
    fingerprint: Annotated[int, "1", "CRC-32 of the constants and of this layout; 0: nothing saved"]
    fault_state: Annotated[int, "1", "a FaultState"]
    verdict: Annotated[int, "1", "a Verdict"]
    found_size: Annotated[float, "1", "size of the fault of the verdict"]
    share: Annotated[float, "1", "lost share of channel 1"]
    share_variance: Annotated[float, "1", "of the share"]
    offset: Annotated[float, "y", "known error of the sensor"]
    theta: Annotated[FloatArray, "1", "θ", SIZES]


@firmware
def save(known: Supervision, fault_state: int) -> None:
    """Write into ``saved`` what is known now; saved knowledge without a begin yet stays."""
    own = known.saved
    if own.fingerprint != 0:
        return
    own.fingerprint = 1
    own.fault_state = fault_state
    own.share = known_share(known.loss_model, known.mismatch)
    own.share_variance = variance_of(known.mismatch.covariance, SHARE)
    own.verdict = known.hypotheses.verdict
    own.found_size = known.hypotheses.found_size
    own.offset = known.hypotheses.sensor_error.offset
    for i in range(MAX_STATES):
        own.theta[i] = known.mismatch.theta[i]


def saved_in(state: layout.State) -> Saved:
    """What a begin of a controller can use of ``state``; ``state`` stays as it is."""
    own: Saved = state.supervision.saved
    before = own.fingerprint
    save(state.supervision, state.fault_state)
    found = own.copy()
    own.fingerprint = before
    return found


@firmware
def known_offset(own: Saved) -> float:
    """The saved error of the sensor."""
    offset: float = own.offset if own.fingerprint != 0 else real(0.0, own.offset)
    return offset


@firmware
def knows_loss(own: Saved) -> bool:
    """Whether a loss of channel 1 is saved."""
    return own.fingerprint != 0 and own.fault_state == CONFIRMED


@firmware
def recall_loss(table: Table, own: Saved, loss: loss_model.State, torque: float) -> float:
    """Return s w in the steady state of a constant ``torque``; 0 where no loss is saved."""
    if not knows_loss(own):
        return real(0.0, torque)
    share = own.share
    w = settle(table.estimator.channel_1, loss.channel_1, torque)
    loss.share = loss.between = loss.followed = share
    loss.delay[:] = loss.previous_output = w
    lost: float = share * w
    return lost


@firmware
def recall_car(
    table: Table, own: Saved, known: mismatch.State, found: verdict.State, w: float, lost: float
) -> None:
    """Go on with the saved θ, verdict and error of the sensor.

    Args:
        table: the constant table.
        own: from then on no longer of use.
        known: of the car; changed in place.
        found: the verdict; changed in place.
        w: the answer of G1 to the torque that ``recall_loss`` was told.
        lost: what ``recall_loss`` answered.
    """
    whitener = table.mismatch.whitener
    if own.fingerprint == 0:
        return
    own.fingerprint = 0
    for i in range(MAX_STATES):
        known.theta[i] = own.theta[i]
    learn_loss(table.mismatch, known, own.share_variance, real(0.0, own.share))
    settle_whitener(whitener, known.white.lost, w)
    if own.verdict != SENSOR_FROZEN and (own.verdict < ANOTHER_CAR or own.verdict == BOTH_LOST):
        found.verdict = own.verdict
        found.found_size = own.found_size
    found.sensor_error.offset = own.offset
    hidden = settle(table.estimator.measurement, found.sensor_error.answer, own.offset)
    settle_whitener(whitener, known.white.sensor_error, hidden)
    settle_whitener(whitener, known.white.d_hat, lost - hidden)
