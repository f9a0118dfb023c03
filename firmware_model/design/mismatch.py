"""Cars that are not the model, as few directions in which the fault estimate can be wrong.

A car that differs in k parameters shows d̂ = (G1 - G1') u1. To first order that is a sum over the
parameters, of which some show almost alike and some hardly at all: the singular vectors of what
they make of d̂ on a step of the reference give the few combinations that matter, largest first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.target.fault_decision.covariance import MAX_DIRECTIONS
from firmware_model.target.structs import FloatArray

STEP = 0.05  # of the box, for a difference that is still linear
LEAST = 1e-3  # of the largest singular value, below which a direction shows nothing
FREQUENCIES = 200

MakeChannel = Callable[[FloatArray], ZeroPoleGain]
"""G1 of the car whose parameters lie at these places, shape (k,), -1..1 across the box."""


@dataclass(frozen=True)
class Mismatch:
    """G1 of other cars, one for each principal direction, ``STEP`` of the box away.

    Attributes:
        cars: at most ``MAX_DIRECTIONS``; none trusts the model.
        singular_values: of all directions, rms of d̂ on a step of 1 a box: what is left out too.
    """

    cars: tuple[ZeroPoleGain, ...] = ()
    singular_values: tuple[float, ...] = ()


TRUSTED = Mismatch()
"""No car but the model."""


def principal_mismatch(make: MakeChannel, parameters: int, tracking_lag_s: float) -> Mismatch:
    """The principal directions of a box of ``parameters`` parameters.

    Args:
        make: G1 of a car in the box; zeros are the model.
        parameters: k.
        tracking_lag_s: of D* behind the reference: what is faster is hardly driven.
    """
    if parameters == 0:
        return TRUSTED
    nominal = make(np.zeros(parameters))
    omega = np.geomspace(0.3, 10.0 / tracking_lag_s, FREQUENCIES)
    # d̂ on a step 1/s of the reference: the relative difference of G1, as far as D* follows
    s = np.asarray(1j * omega, dtype=np.complex128)
    weight = np.sqrt(np.gradient(omega)) / np.abs(s * (1.0 + s * tracking_lag_s) ** 2)
    columns = []
    for i in range(parameters):
        place = np.zeros(parameters)
        place[i] = STEP
        relative = make(place)(s) / nominal(s) - 1.0
        difference = relative / STEP * weight
        columns.append(np.concatenate([difference.real, difference.imag]))
    _, values, directions = np.linalg.svd(np.array(columns).T, full_matrices=False)
    used = [
        direction
        for value, direction in zip(values, directions, strict=True)
        if value > LEAST * values[0]
    ][:MAX_DIRECTIONS]
    cars = tuple(make(STEP * direction) for direction in used)
    return Mismatch(cars, tuple(float(value) for value in values))
