"""Cars that differ from the model, as a few directions of error in the fault estimate.

A car that differs in k parameters shows d̂ = (G1 - G1') u1 + (G2 - G2') u2. To first order d̂ is a
sum over the parameters; some parameters act almost alike and some hardly act. The singular vectors
of the parameters' effects on d̂ at a step of the reference, followed by G1 or by G2 in place of G1,
give the few important combinations, largest first.

For an unstable plant d̂ = ΔN1 u1 + ΔN2 u2 - ΔM y; for y = G u d̂ is M ΔG/G y to first order: the
same effect, filtered by M (``factors.coprime``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from firmware_model.design.factors import left_coprime
from firmware_model.design.zpk import ZeroPoleGain

STEP = 0.05  # share of the box for a linear difference
LEAST = 1e-3  # share of the largest singular value; smaller directions have no visible effect
FREQUENCIES = 200

FloatArray = NDArray[np.float64]
Channels = tuple[ZeroPoleGain, ZeroPoleGain]
MakeChannels = Callable[[FloatArray], Channels]
"""G1, G2 of the car whose parameters lie at these places, shape (k,), -1..1 across the box."""


@dataclass(frozen=True)
class Mismatch:
    """G1, G2 of other cars, one for each principal direction, ``STEP`` of the box away.

    Attributes:
        cars: empty if the model is trusted.
        directions: of each car, shape (k,), unit length.
        singular_values: of all directions (left-out directions too), rms of d̂ on a step of 1 a
            box.
    """

    cars: tuple[Channels, ...] = ()
    singular_values: tuple[float, ...] = ()
    directions: tuple[FloatArray, ...] = field(default=(), compare=False, repr=False)

    @property
    def places(self) -> list[FloatArray]:
        """Where ``cars`` lie in the box, shape (k,) each."""
        return [STEP * direction for direction in self.directions]


TRUSTED = Mismatch()
"""No car but the model."""


def principal_mismatch(
    make: MakeChannels, parameters: int, tau_q_s: float, alpha_q: int, most: int
) -> Mismatch:
    """The principal directions of a box of ``parameters`` parameters.

    Args:
        make: G1, G2 of a car in the box; zeros are the model.
        parameters: k.
        most: of the directions, largest first; what runs has room for ``MAX_DIRECTIONS``.
        tau_q_s: τq of q̂, with which D* lags the reference; faster motion is hardly driven.
        alpha_q: its order.
    """
    if parameters == 0:
        return TRUSTED
    nominal, tracking_lag_s = make(np.zeros(parameters)), tau_q_s * alpha_q
    omega = np.geomspace(min(0.3, 0.1 / tracking_lag_s), 10.0 / tracking_lag_s, FREQUENCIES)
    # d̂ on a step 1/s of the reference, which G1 follows, or G2 instead: the relative difference
    s = np.asarray(1j * omega, dtype=np.complex128)
    weight = np.sqrt(np.gradient(omega)) / np.abs(s * (1.0 + s * tracking_lag_s) ** 2)
    columns = []
    for i in range(parameters):
        place = np.zeros(parameters)
        place[i] = STEP
        channels = make(place)
        left = np.abs(left_coprime(*channels, tau_q_s).denominator(s))
        pairs = zip(channels, nominal, strict=True)
        differences = [(other(s) / own(s) - 1.0) / STEP * weight * left for other, own in pairs]
        columns.append(np.concatenate([part for d in differences for part in (d.real, d.imag)]))
    _, values, directions = np.linalg.svd(np.array(columns).T, full_matrices=False)
    used = [
        direction
        for value, direction in zip(values, directions, strict=True)
        if value > LEAST * values[0]
    ][:most]
    cars = tuple(make(STEP * direction) for direction in used)
    return Mismatch(cars, tuple(float(value) for value in values), tuple(used))
