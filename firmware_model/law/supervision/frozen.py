"""A frozen sensor repeats the same number, whatever the car does.

If the modelled car has moved since the last change of y, two facts speak for a frozen sensor. Noise
never repeats for long: each repetition has a small chance, and its -ln is evidence. And y lacks the
motion since: a signature of known size in d̂. A car at rest may repeat a number with a healthy
sensor and less noise than specified.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct
from firmware_model.law.supervision import candidate
from firmware_model.law.supervision.candidate import State as CandidateState, start, take_in

if TYPE_CHECKING:
    from firmware_model.law.layout import Table
    from firmware_model.law.supervision import mismatch


class Constants(Struct):
    """Constants."""

    size_of_one: Annotated[candidate.Limits, "1", "limits of the size, always 1"]
    least_motion: Annotated[float, "y", "least modelled motion for a repetition to count"]
    repetition: Annotated[float, "1", "-ln of the chance that noise repeats a number"]


class State(Struct):
    """State."""

    candidate: Annotated[CandidateState, "1", "how well missing motion explains d̂"]
    measurement: Annotated[float, "y", "the repeated number"]
    expected: Annotated[float, "y", "modelled y at the first occurrence"]
    repetitions: Annotated[float, "1", "repetitions since"]
    evidence: Annotated[float, "1", "log-likelihood ratio"]


@firmware
def weigh_frozen(
    table: Table, own: State, known: mismatch.State, y: float, innovation: float, expected: float
) -> None:
    """Take in a tick with the measurement ``y``, which the model expects to be ``expected``."""
    constants = table.hypotheses.frozen
    if y != own.measurement:
        thaw(own)
        own.measurement, own.expected = y, expected
        return
    own.repetitions += real(1.0, expected)
    moved = expected - own.expected
    missing = moved
    if table.estimator.measurement.n > 0:  # the model predicts M y, not y
        missing = real(0.0, expected)
    take_in(table.mismatch, known, own.candidate, constants.size_of_one, missing, innovation)
    own.evidence = real(0.0, expected)
    if abs(moved) > constants.least_motion:
        own.evidence = own.candidate.evidence + own.repetitions * constants.repetition


@firmware
def thaw(state: State) -> None:
    """The next number is another."""
    start(state.candidate)
    state.repetitions = state.evidence = 0.0
