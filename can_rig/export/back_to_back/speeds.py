"""Random designs over speed, blending states and speeds of a car: plausible numbers.

The values of the designs are arbitrary. The design speeds ascend, as a schedule requires; the car's
speeds are arbitrary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from can_rig.export.back_to_back.memories import fill
from firmware_model.target.schedule import CONSTANTS, MAX_SPEEDS, STATE
from firmware_model.target.structs import FloatArray, Precision, Record, RecordArray, record_type

SLOWEST, FASTEST = 1.0, 100.0  # m/s


@dataclass(frozen=True)
class Drive:
    """The blending of a table, and the speed before each tick.

    Attributes:
        schedules: the designs, shape (1,).
        blendings: the state of the blending before the first tick, shape (1,).
        speeds: shape (ticks,).
    """

    schedules: RecordArray
    blendings: RecordArray
    speeds: FloatArray


def random_drive(
    random: np.random.Generator, precision: Precision, ticks: int, even: bool = False
) -> Drive:
    """For a random table; ``even``: many numbers are equal."""
    schedules = np.zeros(1, record_type(CONSTANTS, precision))
    schedule: Record = schedules[0]
    fill(random, schedules[0], precision, even)
    n = schedule.n = random.choice([1, 2, MAX_SPEEDS, *random.integers(1, MAX_SPEEDS + 1, 3)])
    schedule.speed[:] = np.sort(random.uniform(SLOWEST, FASTEST, MAX_SPEEDS))
    if random.random() < 0.8:  # turns that leave numbers of ordinary size
        for name in schedules.dtype.names or ():
            if "turn" in name:
                schedules[name] = np.clip(np.nan_to_num(schedules[name]), -2.0, 2.0)
    blendings = np.zeros(1, record_type(STATE, precision))
    fill(random, blendings[0], precision, even)
    blendings["place"] = random.choice([0.0, random.uniform(0.0, n - 1.0), n - 1.0])
    limits = np.finfo(precision)
    odd: list[float] = [np.nan, np.inf, -np.inf, 0.0, -1.0]
    odd += [float(limits.max), float(limits.smallest_subnormal)]
    at_designs = random.choice(schedule.speed[:n], ticks)
    between = random.uniform(0.5 * SLOWEST, 1.2 * FASTEST, ticks)
    kinds = random.choice(3, ticks, p=[0.6, 0.25, 0.15])
    speeds = np.choose(kinds, [between, at_designs, random.choice(odd, ticks)]).astype(precision)
    again = random.random(ticks) < 0.1  # the speed of the tick before
    again[0] = False
    speeds[again] = speeds[np.flatnonzero(again) - 1]
    return Drive(schedules, blendings, speeds)
