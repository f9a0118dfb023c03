"""The CRC of AUTOSAR E2E profile 1 for many frames at once.

A CRC is linear in the covered bits: the exclusive or of a table value per byte of the frame, and of
a constant for the data identifier. The E2E library computes the tables, so that only the library
contains the polynomial.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from e2e.p01 import e2e_p01_protect
from numpy.typing import NDArray

from can_rig.frames.protection import FRAME_BYTES
from firmware_model.compiled import compiled

UInt8s = NDArray[np.uint8]


def crcs(data: UInt8s, data_id: int) -> UInt8s:
    """(n,) CRC for byte 0 of payloads (n, 8 or more)."""
    found: UInt8s = np.empty(len(data), dtype=np.uint8)
    _crcs(data, np.uint8(_crc(bytearray(FRAME_BYTES), data_id)), _tables(), found)
    return found


@compiled
def _crcs(data: UInt8s, crc_of_id: Any, tables: Any, found: UInt8s) -> None:
    for row in range(len(data)):
        crc = crc_of_id
        for byte in range(1, FRAME_BYTES):
            crc ^= tables[byte - 1, data[row, byte]]
        found[row] = crc


@cache
def _tables() -> Any:
    """(7, 256) contribution of every value of bytes 1 to 7 to the CRC."""
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
