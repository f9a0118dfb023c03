"""The end of known faults that d̂ does not show.

A known loss adds s w to d̂, and a known error e of the sensor takes M e away (``sensor_error``).
While the fault is there, d̂ is as large. The end of an offset may look like a second fault that
cancels the first: then both stay known, and d̂ is next to nothing. The known faults end where

    nearer Σ d̂² < Σ (s w)² + Σ (M e)²

for the fading sums since the last finding, once the sums are old enough. The plant then does what
the model does, and a compensation has hardly anything to compensate. A share s below ``least``
counts as ``least``, so a loss without a remaining share ends too.
"""

from __future__ import annotations

import math
from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct


class Constants(Struct):
    """Constants."""

    keep: Annotated[float, "1", "factor per tick of the fading sums"]
    nearer: Annotated[float, "1", "least ratio of the squares of the known faults to those of d̂"]
    least: Annotated[float, "1", "least lost share that would show"]
    age: Annotated[float, "tick", "least age of the sums"]


class State(Struct):
    """State."""

    age: Annotated[float, "tick", "since the last finding"]
    off: Annotated[float, "y²", "fading Σ d̂²"]
    faults: Annotated[float, "y²", "fading sum of the squares of what the known faults show"]


@firmware
def is_healthy(
    constants: Constants, own: State, residual: float, share: float, w: float, error: float
) -> bool:
    """Take in a tick, and return whether the plant shows none of its known faults.

    Args:
        constants: of this module.
        own: changed in place.
        residual: d̂.
        share: the known lost share s.
        w: the output that a lost share of 1 would take away; 0 without a known loss.
        error: M e.
    """
    lost = max(share, constants.least) * w
    own.off = constants.keep * own.off + residual * residual
    own.faults = constants.keep * own.faults + lost * lost + error * error
    own.age += real(1.0, residual)
    if not math.isfinite(own.off):
        clear_health(own)
    nearer: bool = constants.nearer * own.off < own.faults
    return nearer and own.age > constants.age


@firmware
def clear_health(own: State) -> None:
    """The sums begin anew: a finding has changed what is known."""
    own.age = own.off = own.faults = 0.0
