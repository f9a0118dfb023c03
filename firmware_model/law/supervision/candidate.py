"""One hypothesis: a signature of unknown size in d̂, from an onset on.

A fault adds its size m times a signature f to d̂; f is known from the onset on. f is whitened like
the noise, minus the part absorbed by the estimates of the car. Of all sizes between ``least`` and
``most`` the likeliest explains the innovations ν, of variance S, with the log-likelihood ratio

    m (c - ½ m i),    c = Σ f ν/S,  i = Σ f²/S,  m = c/i within its limits

the *evidence*. A size fitted afterwards does not prove the onset, so a second sum predicts each
tick with the size of the tick before. A predicted sum below ``restart`` rejects the onset, and the
present tick becomes the new onset; so does a candidate older than ``lifetime`` without a finding.
For a lost torque the predicted size is given (``likelihood_ratio``).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import FloatArray, Struct
from firmware_model.law.supervision import whitener
from firmware_model.law.supervision.covariance import MAX_STATES
from firmware_model.law.supervision.whitener import whiten

if TYPE_CHECKING:
    from firmware_model.law.supervision import mismatch


class Limits(Struct):
    """Limits of a size."""

    least: Annotated[float, "1", "least size, in the unit of the signature"]
    most: Annotated[float, "1", "largest size, in the unit of the signature"]


class Constants(Struct):
    """Constants."""

    restart: Annotated[float, "1", "predicted log-likelihood ratio that rejects the onset"]
    lifetime: Annotated[float, "tick", "age of a restart without a finding"]
    promising: Annotated[float, "1", "evidence that prevents the restart by age"]
    longest: Annotated[float, "tick", "age of a restart in any case"]


class State(Struct):
    """State."""

    explained: Annotated[FloatArray, "1", "effect of the signature on θ", (MAX_STATES,)]
    white: Annotated[whitener.State, "y", "memory of W for the signature"]
    age: Annotated[float, "tick", "since the onset"]
    correlation: Annotated[float, "1", "c for a size of 1"]
    information: Annotated[float, "1", "i for a size of 1"]
    size_now: Annotated[float, "1", "m, in the unit of the signature"]
    predicted: Annotated[float, "1", "log-likelihood ratio with the sizes of the ticks before"]
    evidence: Annotated[float, "1", "log-likelihood ratio with m"]


@firmware
def take_in(
    constants: mismatch.Constants,
    known: mismatch.State,
    own: State,
    limits: Limits,
    shown: float,
    innovation: float,
) -> None:
    """Take in a tick.

    Args:
        constants: of the mismatch.
        known: of the car, of this tick.
        own: state of this module; changed in place.
        limits: the limits of the size.
        shown: the part of a size-1 signature in d̂ of this tick.
        innovation: ν.
    """
    first, half = known.covariance.first, real(0.5, shown)
    signature = whiten(constants.whitener, own.white, shown)
    for i in range(first, constants.n):
        signature -= known.regressor[i] * own.explained[i]
    for i in range(first, constants.n):
        own.explained[i] = known.memory[i] * (own.explained[i] + known.gain[i] * signature)
    weight = signature / known.variance
    correlation, information = weight * innovation, weight * signature
    own.predicted += own.size_now * (correlation - half * own.size_now * information)
    own.correlation += correlation
    own.information += information
    own.age += real(1.0, shown)
    own.size_now = likeliest(own.correlation, own.information, limits)
    own.evidence = own.size_now * (own.correlation - half * own.size_now * own.information)


@firmware
def likeliest(correlation: float, information: float, limits: Limits) -> float:
    """The likeliest size within ``limits``; 0 without information."""
    size = real(0.0, correlation)
    if information > real(0.0, correlation):
        size = min(max(correlation / information, limits.least), limits.most)
    return size


@firmware
def has_failed(constants: Constants, own: State) -> bool:
    """Whether the onset is rejected, or too old to gain more evidence."""
    if not (own.predicted > constants.restart and math.isfinite(own.evidence)):
        return True
    old = own.age >= constants.lifetime and not own.evidence > constants.promising
    failed: bool = old or own.age >= constants.longest
    return failed


@firmware
def start(own: State) -> None:
    """The onset is now."""
    own.explained[:] = 0.0
    own.white.memory[:] = 0.0
    count_anew(own)


@firmware
def count_anew(own: State) -> None:
    """Only later ticks are evidence of a fault whose onset stays."""
    own.age = own.correlation = own.information = 0.0
    own.size_now = own.predicted = own.evidence = 0.0
