"""An actuator, a sensor and their frames in one tick, healthy or with a fault.

A frame carries whole steps of the signal, or a floating-point number of given width, within a
range. A fault is a row of numbers: ticks of delay of a command or a reading, factor, addend,
whether the value freezes, largest change in a tick; and whether a substitute replaces the value,
and the substitute.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from firmware_model.compiled import firmware
from firmware_model.law.structs import FloatArray

LATE, GAIN, ADDED, HELD, SLEW, REPLACED, BY, DISTORTION = range(8)
"""The places in the row of a fault, and how many they are."""

DOUBLE: Final = 64
SENSOR: Final = 2
"""The row of the sensor, after those of both actuators."""

STEP, LEAST, MOST, BITS, SMALLEST, GRID = range(6)
"""The places in the row of a frame, and how many they are."""

NO_LIMITS: Final[FloatArray] = np.full((2, 2), np.inf)
HEALTHY: Final[FloatArray] = np.array([0.0, 1.0, 0.0, 0.0, np.inf, 0.0, np.nan])
NO_FAULTS: Final[FloatArray] = np.empty((0, 3, DISTORTION))
EXACT_FRAMES: Final[FloatArray] = np.tile([0.0, -np.inf, np.inf, 0.0, 0.0], (3, 1))
"""Frames of both commands and of the sensor that carry any number."""


def frame_of(step: float, least: float, most: float, bits: int = 0) -> FloatArray:
    """The row of a frame, (``GRID``,): for `carried`.

    Args:
        step: step of the signal, in the signal's unit; 0 for a float.
        least: smallest value in the frame, in the signal's unit.
        most: largest.
        bits: of a float: 16, 32 or 64.
    """
    if not bits:
        return np.array([step, least, most, 0.0, 0.0])
    kind = np.finfo(f"f{bits // 8}")
    digits = 0.0 if bits == DOUBLE else kind.nmant + 1.0  # every number here is a double
    return np.array([0.0, least, most, digits, kind.minexp + 1.0])


@firmware
def sensor_reading(read: float, bias: float, noise: float, resolution: float) -> float:
    """What the sensor says: with bias and noise, in whole steps of its ``resolution`` (0: none)."""
    reading = read + bias + noise
    if resolution > 0.0:
        reading = np.rint(reading / resolution) * resolution
    return reading


@firmware
def carried(value: float, frame: FloatArray) -> float:
    """``value`` after transport in a ``frame``, (``GRID``,): saturated, in whole steps."""
    if math.isnan(value):
        return value
    inside: float = min(max(value, frame[LEAST]), frame[MOST])
    step: float = frame[STEP]
    if frame[BITS] > 0.0:
        _, exponent = math.frexp(inside)
        step = math.ldexp(1.0, int(max(float(exponent), frame[SMALLEST]) - frame[BITS]))
    if step > 0.0:
        inside = np.rint(inside / step) * step
    return inside


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
