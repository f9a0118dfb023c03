"""A plant at constant speed on a constant road that the world pushes, exact between two ticks.

The world's inputs w are straight lines between two ticks. By superposition a tick of
``sampled_plant`` gains

    x⁺ = ... + Γ₀ w(k) + Γ₁ w(k+1),   y = ... + H₀ w(k) + H₁ w(k+1)

from the exponential of [A E 0; 0 0 I/T; 0 0 0], a first-order hold of w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from firmware_model.analysis.sampled_plant import SampledPlant, follow, sample, split_ticks
from firmware_model.analysis.witnesses import NO_READINGS, Readings
from firmware_model.compiled import firmware
from firmware_model.design.plants import Plant
from firmware_model.law.structs import FloatArray


@dataclass(frozen=True)
class PushedPlant:
    """The step above; n states, m inputs of the world, r further sensors.

    Attributes:
        sampled: the plant in a calm world.
        gamma: (2, n, m), Γ₀ and Γ₁.
        output: (2, m), H₀ and H₁ of the output before the sensor.
        reading: (2, m), of the sensor's reading, before its whole ticks of dead time.
        rows: (r, n), the further sensors at a tick: ``rows x + direct w``.
        direct: (r, m).
    """

    sampled: SampledPlant
    gamma: FloatArray
    output: FloatArray
    reading: FloatArray
    rows: FloatArray
    direct: FloatArray

    @property
    def constants(self) -> Any:
        """The constants of ``follow_pushed``, for compiled code."""
        return self.sampled.constants, (self.gamma, self.output, self.reading)


def pushed_plant(plant: Plant, tick_s: float, readings: Readings = NO_READINGS) -> PushedPlant:
    """Discretise a ``plant`` that has a ``world``, for ticks of ``tick_s`` seconds.

    ``readings`` are those of further sensors.
    """
    world = plant.world
    assert world is not None
    _, part = split_ticks(plant.sensor_dead_time_s / tick_s)
    sensed = plant.c if plant.sensed is None else plant.sensed
    gamma = _first_order_hold(plant.a, world.e, tick_s, 1.0)
    read = _first_order_hold(plant.a, world.e, tick_s, 1.0 - part)
    share = np.array([part, 1.0 - part])[:, None]
    return PushedPlant(
        sample(plant, tick_s, readings),
        gamma,
        sensed[0] @ gamma + np.array([0.0, 1.0])[:, None] * world.f,
        plant.c[0] @ read + share * world.read,
        world.rows,
        world.direct,
    )


def _first_order_hold(a: FloatArray, e: FloatArray, tick_s: float, until: float) -> FloatArray:
    """(2, n, m): what w at the begin and at the end of a tick give x by the part ``until``."""
    n, m = e.shape
    augmented = np.zeros((n + 2 * m, n + 2 * m))
    augmented[:n, :n], augmented[:n, n : n + m] = a * tick_s, e * tick_s
    augmented[n : n + m, n + m :] = np.eye(m)
    exponential = linalg.expm(augmented * until)
    held, rising = exponential[:n, n : n + m], exponential[:n, n + m :]
    return np.stack([held - rising, rising])


@firmware
def follow_pushed(
    constants: Any,
    memory: Any,
    k: int,
    u1: float,
    u2: float,
    left_1: float,
    left_2: float,
    world: Any,
) -> tuple[float, float]:
    """``sampled_plant.follow`` in the world.

    Args:
        constants: of a ``PushedPlant``.
        memory: of its ``SampledPlant``; changed in place.
        k: the tick; commands and what a fault leaves of them.
        u1: see ``k``.
        u2: see ``k``.
        left_1: see ``k``.
        left_2: see ``k``.
        world: (2, m or more), w at this tick and at the next in the first m columns.
    """
    plant, (gamma, outputs, readings) = constants
    output, reading = follow(plant, memory, k, u1, u2, left_1, left_2)
    x, _, _, samples = memory
    dead, immediate = plant[2], plant[3]
    felt = read = 0.0
    for at in range(2):
        for each in range(gamma.shape[2]):
            w = world[at, each]
            felt += outputs[at, each] * w
            read += readings[at, each] * w
            for i in range(len(x)):
                x[i] += gamma[at, i, each] * w
    if immediate:
        return output + felt, reading + read
    samples[(k + 1) % len(samples)] += read
    return output + felt, samples[(k + 1 - dead[2]) % len(samples)]


@firmware
def witness(rows: Any, direct: Any, x: Any, world: Any, each: int) -> float:
    """What further sensor ``each`` reads at the begin of a tick; for the arguments see above."""
    total = 0.0
    for j in range(len(x)):
        total += rows[each, j] * x[j]
    for j in range(direct.shape[1]):
        total += direct[each, j] * world[0, j]
    return total
