"""One hypothesis: a signature of unknown size in d̂, from an onset on.

What a fault adds to d̂ is its size m times a signature f that is known from its onset on. As in
``sequential_test`` f is whitened as the noise is, and less what the estimates of the car would have
made of it. Of all sizes between ``least`` and ``most`` the likeliest explains the innovations ν, of
variance S, with the log-likelihood ratio

    m (c - ½ m i),    c = Σ f ν/S,  i = Σ f²/S,  m = c/i within its limits

the *evidence*. That a size fits afterwards does not prove the onset, so it is also foretold: the
same sum, in each tick with the size of the tick before. Where that falls below ``restart`` the
onset was none, and this tick is the next one; so it is where the candidate is older than
``lifetime`` and has found nothing.
"""

from __future__ import annotations

import math

from firmware_model.compiled import firmware
from firmware_model.target.fault_decision.covariance import MAX_STATES
from firmware_model.target.precision import real
from firmware_model.target.structs import Field, Record

LIMITS = (
    Field("least", "1", "size, in the unit of its signature"),
    Field("most", "1", "likewise"),
)
CONSTANTS = (
    Field("restart", "1", "foretold log-likelihood ratio below which the onset was none"),
    Field("lifetime", "tick", "age at which a candidate that found nothing begins again"),
    Field("promising", "1", "evidence with which it does not"),
)
STATE = (
    Field("explained", "1", "what the signature makes of θ", shape=(MAX_STATES,)),
    Field("previous_shown", "y", "the signature in d̂ of the last tick"),
    Field("age", "tick", "since the onset"),
    Field("correlation", "1", "c for a size of 1"),
    Field("information", "1", "i for a size of 1"),
    Field("size_now", "1", "m, in the unit of the signature"),
    Field("foretold", "1", "log-likelihood ratio with the sizes of the ticks before"),
    Field("evidence", "1", "log-likelihood ratio with m"),
)


@firmware
def take_in(
    table: Record, state: Record, own: Record, limits: Record, shown: float, innovation: float
) -> None:
    """Take in a tick.

    Args:
        table: the constant table.
        state: of the controller; ``mismatch`` is that of this tick.
        own: state of this module; changed in place.
        limits: of its size.
        shown: the signature of size 1 as d̂ of this tick contains it.
        innovation: ν.
    """
    mismatch, half = state.mismatch, real(0.5, shown)
    signature = shown - table.mismatch.colour * own.previous_shown
    own.previous_shown = shown
    for i in range(table.mismatch.n):
        signature -= mismatch.regressor[i] * own.explained[i]
    for i in range(table.mismatch.n):
        own.explained[i] = mismatch.memory[i] * (own.explained[i] + mismatch.gain[i] * signature)
    weight = signature / mismatch.variance
    correlation, information = weight * innovation, weight * signature
    own.foretold += own.size_now * (correlation - half * own.size_now * information)
    own.correlation += correlation
    own.information += information
    own.age += real(1.0, shown)
    own.size_now = likeliest(own.correlation, own.information, limits)
    own.evidence = own.size_now * (own.correlation - half * own.size_now * own.information)


@firmware
def likeliest(correlation: float, information: float, limits: Record) -> float:
    """The size within ``limits`` that explains most; 0 where nothing is known of it."""
    size = real(0.0, correlation)
    if information > real(0.0, correlation):
        size = min(max(correlation / information, limits.least), limits.most)
    return size


@firmware
def has_failed(constants: Record, own: Record) -> bool:
    """Whether the onset was none, or is so long ago that nothing more will come of it."""
    if not (own.foretold > constants.restart and math.isfinite(own.evidence)):
        return True
    old: bool = own.age >= constants.lifetime and not own.evidence > constants.promising
    return old


@firmware
def start(own: Record) -> None:
    """The onset is now."""
    own.explained[:] = 0.0
    own.previous_shown = own.age = own.correlation = own.information = 0.0
    own.size_now = own.foretold = own.evidence = 0.0
