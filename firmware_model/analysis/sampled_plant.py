"""A plant between two ticks: exact for commands that are held, as actuators on a bus hold them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from firmware_model.compiled import firmware
from firmware_model.design.plants import Plant
from firmware_model.errors import ParameterError
from firmware_model.target.structs import FloatArray


@dataclass(frozen=True)
class SampledPlant:
    """x⁺ = Φx + Γu, y = cx with Φ = e^{AT}, Γ = ∫e^{At}dt B over one tick.

    Attributes:
        phi: (n, n). gamma: (n, 2). c: (n,). Read-only, float64.
        tick_s: the tick, seconds.
    """

    phi: FloatArray
    gamma: FloatArray
    c: FloatArray
    tick_s: float

    @property
    def rest(self) -> FloatArray:
        """A state at rest, shape (n,)."""
        return np.zeros(len(self.c))


def sample(plant: Plant, tick_s: float) -> SampledPlant:
    """Discretise ``plant`` exactly for commands held over ``tick_s`` seconds.

    Raises:
        ParameterError: a tick that is not a finite time above zero.
    """
    if not 0.0 < tick_s < float("inf"):
        raise ParameterError(f"tick_s = {tick_s:g}: must be finite and above 0 s")
    n = len(plant.a)
    augmented = np.zeros((n + 2, n + 2))
    augmented[:n, :n] = plant.a
    augmented[:n, n:] = plant.b
    exponential = linalg.expm(augmented * tick_s)
    phi = np.ascontiguousarray(exponential[:n, :n])
    gamma = np.ascontiguousarray(exponential[:n, n:])
    c = np.ascontiguousarray(plant.c[0])
    for array in (phi, gamma, c):
        array.flags.writeable = False
    return SampledPlant(phi, gamma, c, tick_s)


@firmware
def advance_plant(phi: Any, gamma: Any, x: Any, u1: float, u2: float) -> None:
    """The state one tick later, in place; plain loops, so that every machine adds in one order."""
    n = len(x)
    after = np.empty(n)
    for i in range(n):
        total = gamma[i, 0] * u1 + gamma[i, 1] * u2
        for j in range(n):
            total += phi[i, j] * x[j]
        after[i] = total
    for i in range(n):
        x[i] = after[i]


@firmware
def measure_plant(c: Any, x: Any) -> float:
    """The output y = cx."""
    total = 0.0
    for j in range(len(x)):
        total += c[j] * x[j]
    return total


@firmware
def follow_plant(phi: Any, gamma: Any, c: Any, x: Any, u1: float, u2: float) -> float:
    """Advance by one tick, in place, and measure."""
    advance_plant(phi, gamma, x, u1, u2)
    return measure_plant(c, x)
