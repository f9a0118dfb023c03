"""What the sensor is known to add to y, once it has been found biased or drifting.

The decision takes it out of d̂, as if it had never been in it, so that a motor that is lost later is
found as soon as ever. A drift that goes on is found again and again, each time by what it has come
to since. C and F1 do not know of it: without a second sensor, y less a bias that a verdict believes
in is no better a y.
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.filters import biquad
from firmware_model.target.filters.biquad import advance, output
from firmware_model.target.precision import real
from firmware_model.target.structs import Field, Record

STATE = (
    Field("offset", "y", "what the sensor adds to y"),
    Field("answer", "y", "state of M driven by it", biquad.STATE),
)


@firmware
def sensor_error_shown(table: Record, state: Record) -> float:
    """What d̂ of this tick lacks of G1 u1 + G2 u2 by it: M times the offset."""
    own = state.hypotheses.sensor_error
    shown: float = output(table.estimator.measurement, own.answer, own.offset)
    return shown


@firmware
def advance_sensor_error(table: Record, state: Record) -> None:
    """A tick on."""
    own = state.hypotheses.sensor_error
    advance(table.estimator.measurement, own.answer, own.offset)


@firmware
def learn_sensor_error(table: Record, state: Record, found: Record, input_now: float) -> bool:
    """Take in an error that has been found; θ forgets what it has learnt from it.

    Args:
        table: the constant table.
        state: of the controller; changed in place.
        found: the hypothesis, whose size is in the unit of its signature.
        input_now: of this signature, before M: -1 of a bias.

    Returns:
        Whether the error of before is gone by that: less than half of it is left. Not where a probe
        asks the motor: there the verdict changes nothing.
    """
    if table.probe.ticks > 0:
        return False
    own, size = state.hypotheses.sensor_error, found.candidate.size_now
    half, before = real(0.5, size), own.offset
    for i in range(table.mismatch.n):
        state.mismatch.theta[i] -= size * found.candidate.explained[i]
    own.offset = before - size * input_now
    for i in range(table.estimator.measurement.n):
        for j in range(2):
            own.answer.accumulators[i, j] -= size * found.answer.accumulators[i, j]
    gone: bool = abs(own.offset) < half * abs(before)
    if gone:
        clear_sensor_error(own)
    return gone


@firmware
def clear_sensor_error(own: Record) -> None:
    """It adds nothing."""
    own.offset = 0.0
    own.answer.accumulators[:] = 0.0
