"""The check of AUTOSAR E2E profile 1 for many frames at once: a vectorised `frames.protection`."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from can_rig.frames.frame_columns import crcs
from can_rig.frames.protection import COUNTERS, FRAME_BYTES
from can_rig.logs.frames import UInt8s

COUNTER_BITS: Final = 0x0F

Rows = NDArray[np.bool_]


def intact(data: UInt8s, length: UInt8s, data_id: int) -> Rows:
    """(n,) result of e2e_p01_check for payloads (n, 8 or more) of these lengths."""
    whole: Rows = crcs(data, data_id) == data[:, 0]
    whole &= counters(data) < COUNTERS
    whole &= length == FRAME_BYTES
    return whole


def counters(data: UInt8s) -> UInt8s:
    """(n,) alive counters of payloads."""
    return data[:, 1] & np.uint8(COUNTER_BITS)


def steps(counter: UInt8s, before: int | None) -> NDArray[np.int64]:
    """(n,) increments of the counter, 0..14; 1 is in sequence.

    Args:
        counter: (n,) of intact frames, in their order.
        before: the last preceding counter; None: the first frame starts the sequence.
    """
    numbers = counter.astype(np.int64)
    first = (numbers[:1] - 1) if before is None else np.array([before])
    ahead: NDArray[np.int64] = np.diff(numbers, prepend=first[: len(numbers)]) % COUNTERS
    return ahead
