"""AUTOSAR E2E profile 1 for many frames at once: the CRC and the counter of `frames.protection`.

A CRC is linear in the bits that it covers: it is the exclusive or of a table value for each byte of
the frame, and of a constant for the data identifier. The tables are computed with the E2E library,
so that the polynomial stays there only.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from e2e.p01 import e2e_p01_protect
from numpy.typing import NDArray

from can_rig.frames.protection import FRAME_BYTES
from can_rig.logs.frames import UInt8s
from firmware_model.compiled import compiled

COUNTERS: Final = 15
"""Counters are 0..14; 15 is never sent."""

Rows = NDArray[np.bool_]


def intact(data: UInt8s, length: UInt8s, data_id: int) -> Rows:
    """(n,) result of e2e_p01_check for payloads (n, 8 or more) of these lengths."""
    whole: Rows = np.empty(len(data), dtype=np.bool_)
    _check(data, length, np.uint8(_crc(bytearray(FRAME_BYTES), data_id)), _tables(), whole)
    return whole


@compiled
def _check(data: UInt8s, length: UInt8s, crc_of_id: Any, tables: Any, whole: Rows) -> None:
    for row in range(len(data)):
        crc = crc_of_id
        for byte in range(1, FRAME_BYTES):
            crc ^= tables[byte - 1, data[row, byte]]
        is_counted = (data[row, 1] & 0x0F) < COUNTERS
        whole[row] = crc == data[row, 0] and is_counted and length[row] == FRAME_BYTES


def counters(data: UInt8s) -> UInt8s:
    """(n,) alive counters of payloads."""
    return data[:, 1] & np.uint8(0x0F)


def steps(counter: UInt8s, before: int | None) -> NDArray[np.int64]:
    """(n,) difference of each counter to the one before it, 0..14; 1 is in sequence.

    Args:
        counter: (n,) of intact frames, in their order.
        before: the last counter before them; None: the first frame starts the sequence.
    """
    numbers = counter.astype(np.int64)
    first = (numbers[:1] - 1) if before is None else np.array([before])
    ahead: NDArray[np.int64] = np.diff(numbers, prepend=first[: len(numbers)]) % COUNTERS
    return ahead


@cache
def _tables() -> Any:
    """(7, 256) contribution of each value of bytes 1 to 7 to the CRC."""
    nothing = _crc(bytearray(FRAME_BYTES), 0)
    tables = np.zeros((FRAME_BYTES - 1, 256), dtype=np.uint8)
    for byte in range(1, FRAME_BYTES):
        for value in range(256):
            frame = bytearray(FRAME_BYTES)
            frame[byte] = value
            tables[byte - 1, value] = _crc(frame, 0) ^ nothing
    return tables


def _crc(frame: bytearray, data_id: int) -> int:
    e2e_p01_protect(frame, data_id, increment_counter=False)
    return frame[0]
