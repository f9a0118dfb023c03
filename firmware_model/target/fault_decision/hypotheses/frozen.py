"""A sensor that is frozen says the same number again and again, whatever the car does.

Two things speak for it. Noise never repeats for long: each repetition has a small chance, and its
-ln is evidence. And where the car, by the model, is not where it was at the last change, its motion
since is missing in y: a signature of known size in d̂.
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.fault_decision.hypotheses import candidate
from firmware_model.target.fault_decision.hypotheses.candidate import start, take_in
from firmware_model.target.precision import real
from firmware_model.target.structs import Field, Record

CONSTANTS = (
    Field("size_of_one", "1", "limits of the size: it is 1", candidate.LIMITS),
    Field("repetition", "1", "-ln of the chance that noise repeats a number"),
)
STATE = (
    Field("candidate", "1", "how well missing motion explains d̂", candidate.STATE),
    Field("measurement", "y", "the number that is repeated"),
    Field("expected", "y", "y by the model when it came first"),
    Field("repetitions", "1", "of it since"),
    Field("evidence", "1", "log-likelihood ratio"),
)


@firmware
def weigh_frozen(table: Record, state: Record, innovation: float, expected: float) -> None:
    """Take in a tick, of which the model expects y to be ``expected``."""
    constants, own = table.hypotheses.frozen, state.hypotheses.frozen
    if state.measurement != own.measurement:
        thaw(own)
        own.measurement, own.expected = state.measurement, expected
        return
    own.repetitions += real(1.0, expected)
    moved = real(0.0, expected)
    if table.estimator.measurement.n == 0:  # otherwise y is not what the model says, M y is
        moved = expected - own.expected
    take_in(table, state, own.candidate, constants.size_of_one, moved, innovation)
    own.evidence = own.candidate.evidence + own.repetitions * constants.repetition


@firmware
def thaw(state: Record) -> None:
    """The next number is another."""
    start(state.candidate)
    state.repetitions = state.evidence = 0.0
