"""The known error of the sensor in y, after a bias or drift has been found.

The decision removes the known error from d̂ completely, so a later loss of the motor is found
without extra delay. A continuing drift is found repeatedly, each time by its growth since. C and F1
ignore the known error: without a second sensor, subtracting a believed bias does not improve y.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct
from firmware_model.law.supervision.whitener import add_signal

if TYPE_CHECKING:
    from firmware_model.law.layout import Table
    from firmware_model.law.supervision import mismatch, signatures


class State(Struct):
    """State."""

    offset: Annotated[float, "y", "known error of the sensor in y"]
    answer: Annotated[biquad.State, "y", "state of M driven by the offset"]


@firmware
def sensor_error_shown(table: Table, own: State) -> float:
    """The part of G1 u1 + G2 u2 missing in d̂ of this tick: M times the offset."""
    shown: float = output(table.estimator.measurement, own.answer, own.offset)
    return shown


@firmware
def advance_sensor_error(table: Table, own: State) -> None:
    """A tick on."""
    advance(table.estimator.measurement, own.answer, own.offset)


@firmware
def learn_sensor_error(
    table: Table, own: State, known: mismatch.State, found: signatures.One, input_now: float
) -> bool:
    """Add a found sensor error; θ forgets the error's influence.

    Args:
        table: the constant table.
        own: changed in place.
        known: of the car; changed in place.
        found: the hypothesis; its size has the unit of the signature.
        input_now: input of the signature before M: -1 for a bias.

    Returns:
        Whether the earlier error is gone: less than half is left.
    """
    size, before = found.candidate.size_now, own.offset
    half = real(0.5, size)
    for i in range(table.mismatch.n):
        known.theta[i] -= size * found.candidate.explained[i]
    own.offset = before - size * input_now
    for i in range(table.estimator.measurement.n):
        for j in range(2):
            own.answer.accumulators[i, j] -= size * found.answer.accumulators[i, j]
    white = known.white.sensor_error
    add_signal(table.mismatch.whitener, white, -size, found.candidate.white)
    gone: bool = abs(own.offset) < half * abs(before)
    if gone:  # the traces in M and W fade
        own.offset = 0.0
    return gone


@firmware
def clear_sensor_error(own: State) -> None:
    """It adds nothing."""
    own.offset = 0.0
    own.answer.accumulators[:] = 0.0
