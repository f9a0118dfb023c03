"""An actuator and a sensor in one tick, healthy or with a fault.

A fault is a row of numbers: by how many ticks a command or a reading is late, a factor and an
addend of it, whether it stays as it was in the tick before, by how much it can change in a tick;
and whether something else has come in its place, and what.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.target.structs import FloatArray

LATE, GAIN, ADDED, HELD, SLEW, REPLACED, BY, DISTORTION = range(8)
"""The places in the row of a fault, and how many they are."""

SENSOR: Final = 2
"""The row of the sensor, behind those of both actuators."""

NO_LIMITS: Final[FloatArray] = np.full((2, 2), np.inf)
HEALTHY: Final[FloatArray] = np.array([0.0, 1.0, 0.0, 0.0, np.inf, 0.0, np.nan])
NO_FAULTS: Final[FloatArray] = np.empty((0, 3, DISTORTION))


@firmware
def sensor_reading(read: float, bias: float, noise: float, resolution: float) -> float:
    """What the sensor says: with bias and noise, in whole steps of its ``resolution`` (0: none)."""
    reading = read + bias + noise
    if resolution > 0.0:
        reading = np.rint(reading / resolution) * resolution
    return reading


@firmware
def distorted(value: float, previous: float, fault: FloatArray) -> float:
    """What ``fault`` makes of ``value``, (``DISTORTION``,), after ``previous`` in the last tick."""
    if fault[HELD] != 0.0:
        return previous
    wanted: float = fault[GAIN] * value + fault[ADDED]
    slew: float = fault[SLEW]
    if math.isinf(slew) or math.isnan(previous):
        return wanted
    return min(max(wanted, previous - slew), previous + slew)


@firmware
def limited(command: float, previous: float, largest: float, slew: float) -> float:
    """``command`` within an actuator's magnitude, and within its slew of the ``previous`` one."""
    return min(max(command, -largest, previous - slew), largest, previous + slew)
