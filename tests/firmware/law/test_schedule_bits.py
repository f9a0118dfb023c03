"""Tables blended and states turned have the same bits compiled and interpreted."""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.law import controller
from firmware_model.law.schedule import State, change_speed
from firmware_model.law.structs import Precision, zeroed
from tests.firmware.both_ways import lines_compiled_and_interpreted
from tests.firmware.scheduled import SPEEDS, TARGET, scheduled

TICKS = 60
PRECISIONS: tuple[Precision, ...] = ("float32", "float64")


def digests(precision: Precision) -> Iterator[str]:
    """Of the coefficients, of the state and of the blending, after every tick."""
    of = scheduled(target=replace(TARGET, precision=precision), cars=2)
    tables = np.array([of.table], of.table.dtype)
    states = controller.init(tables[0])
    own = zeroed(State, precision)
    for k in range(TICKS):
        speed = SPEEDS[0] + (SPEEDS[-1] - SPEEDS[0]) * abs(math.sin(0.1 * k))
        change_speed(of.schedule, own[0], tables[0], states[0], speed)
        controller.step(tables[0], states[0], math.sin(0.2 * k), 0.5 * math.sin(0.2 * k - 0.4))
        parts = (tables["estimator"]["channel_1"]["coefficients"], states, own)
        yield hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


@pytest.mark.compiled
def test_a_drive_is_bit_identical_compiled_and_interpreted():
    outputs = lines_compiled_and_interpreted(__file__)
    assert len(set(outputs[0])) == len(PRECISIONS) * TICKS
    assert outputs[0] == outputs[1]


if __name__ == "__main__":
    for chosen in PRECISIONS:
        for digest in digests(chosen):
            print(digest)
