"""The model's prediction in place of a measurement that is missing or distrusted.

C is internal model control, u1 = Q (r - y + G1 u1). With the prediction G1 u1 + G2 u2 in place of y
(minus the known loss), C is the feedforward Q r. The prediction carries the slow part of the
difference y - prediction, as last seen by the sensor, or as seen by the witness.

C never sees a jump between measurement and prediction: the difference of the two fades. The fault
estimate gets the measurement at once.

A model that feeds the commands through within the tick predicts y only from the commands that
follow from y. The prediction is not enabled then, and the controller holds its commands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core.biquad import output
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct

if TYPE_CHECKING:
    from firmware_model.law.core import biquad
    from firmware_model.law.layout import Table


class Constants(Struct):
    """Constants."""

    enabled: Annotated[
        int, "1", "0: commands feed through to the measurement of their tick", (0, 1)
    ]
    fading: Annotated[float, "1", "factor per tick of a difference that fades"]
    longest: Annotated[float, "tick", "time without an input until the commands go to zero"]


class State(Struct):
    """State."""

    difference: Annotated[float, "y", "slow part of y - prediction"]
    fading: Annotated[float, "y", "C's y minus the measurement or its stand-in, fading"]
    elapsed: Annotated[float, "tick", "ticks since the last tick with both inputs or a witness"]


@firmware
def predicted(table: Table, own: biquad.State, shown: float) -> float:
    """Return y, where the model and the known loss expect M y = ``shown``; ``own``: of M."""
    cascade = table.estimator.measurement
    if cascade.n == 0:
        return shown
    rest = output(cascade, own, real(0.0, shown))
    for_one: float = output(cascade, own, real(1.0, shown)) - rest
    return (shown - rest) / for_one


@firmware
def note_measurement(constants: Constants, own: State, y: float, expected: float) -> None:
    """Take in a measurement ``y``; the prediction was ``expected``."""
    difference = y - expected
    if own.elapsed > 0.0:
        own.fading += own.difference - difference
        own.elapsed = 0.0
    own.difference = difference + constants.fading * (own.difference - difference)
    own.fading = constants.fading * own.fading


@firmware
def stand_in(constants: Constants, own: State, expected: float) -> float:
    """Return what stands in for the measurement; the prediction is ``expected``."""
    own.elapsed += real(1.0, expected)
    own.fading = constants.fading * own.fading
    measurement: float = expected + own.difference
    return measurement


@firmware
def turn_to_witness(own: State, difference: float) -> None:
    """The sensor is denied: C gets the witness at once, without a fade from wrong numbers."""
    own.difference, own.fading = difference, real(0.0, difference)
    own.elapsed = max(own.elapsed, real(1.0, difference))


@firmware
def follow_witness(constants: Constants, own: State, difference: float) -> None:
    """The witness last said so of y - prediction; the controller is not blind."""
    own.elapsed = min(own.elapsed, real(1.0, difference))
    own.difference = difference + constants.fading * (own.difference - difference)


@firmware
def distrust(own: State, y: float, expected: float) -> None:
    """The sensor is found frozen at ``y``: so is the difference from the prediction."""
    if own.elapsed == 0.0:
        own.fading += y - expected
        own.difference = 0.0


@firmware
def clear_prediction(own: State) -> None:
    """The plant is the model."""
    own.difference = own.fading = own.elapsed = 0.0
