"""A DBC frame for every tick of a run at once: the arrays of `codec` and `protection`.

A CRC is linear in the covered bits: the exclusive or of a table value per byte of the frame, and of
a constant for the data identifier. The E2E library computes the tables, so that only the library
contains the polynomial.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from e2e.p01 import e2e_p01_protect
from numpy.typing import NDArray

from can_rig.frames.codec import WIRE_TICKS, MessageCodec, RigLayout
from can_rig.frames.protection import COUNTERS, FRAME_BYTES
from firmware_model.compiled import compiled
from firmware_model.target.structs import FloatArray

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


Ints = NDArray[np.int64]


def payloads(
    codec: MessageCodec,
    values: FloatArray,
    first_tick: int,
    mode: Ints | None = None,
    fault_state: Ints | None = None,
    verdict: Ints | None = None,
) -> UInt8s:
    """(n, 8), the next frames of a `Transmitter` after a frame in every tick from 0.

    Args:
        codec: a frame with the rig's layout.
        values: (n,), in the unit of the DBC; see `MessageCodec.encode`.
        first_tick: that of the first value.
        mode: (n,), of the status frame.
        fault_state: (n,), likewise.
        verdict: (n,), likewise; ignored for a frame without a verdict.
    """
    layout, data_id = codec.layout, codec.data_id
    assert isinstance(layout, RigLayout) and data_id is not None
    ticks = first_tick + np.arange(len(values), dtype=np.int64)
    bits = ticks % COUNTERS
    if mode is not None and fault_state is not None:
        mode_shift, fault_state_shift = layout.shifts
        bits |= mode << mode_shift | fault_state << fault_state_shift
    data = np.zeros((len(values), FRAME_BYTES), dtype=np.uint8)
    data[:, 1] = bits
    data[:, 2:4] = (ticks % WIRE_TICKS).astype("<u2")[:, np.newaxis].view(np.uint8)
    raw = raw_values(codec, values)
    if layout.verdict_bits:
        raw = raw << layout.verdict_bits | (0 if verdict is None else verdict)
    data[:, 4:8] = raw.astype("<i4")[:, np.newaxis].view(np.uint8)
    data[:, 0] = crcs(data, data_id)
    return data


def raw_values(codec: MessageCodec, values: FloatArray) -> Ints:
    """(n,) raw values; see `MessageCodec.to_raw`."""
    limits = float(codec.lsb), float(codec.minimum), float(codec.maximum)
    ends = int(codec.raw_minimum), int(codec.raw_maximum), int(codec.not_available)
    return _raw(np.ascontiguousarray(values), limits, ends)


@compiled
def _raw(
    values: FloatArray, limits: tuple[float, float, float], ends: tuple[int, int, int]
) -> Ints:
    lsb, minimum, maximum = limits
    raw_minimum, raw_maximum, not_available = ends
    raw = np.empty(len(values), np.int64)
    for k in range(len(values)):
        if math.isnan(values[k]):
            raw[k] = not_available
        elif values[k] >= maximum:
            raw[k] = raw_maximum
        elif values[k] <= minimum:
            raw[k] = raw_minimum
        else:
            raw[k] = int(np.rint(values[k] / lsb))
    return raw


def quantised(codec: MessageCodec, values: FloatArray) -> FloatArray:
    """(n,) ``values`` at the receiver; see `MessageCodec.quantise`."""
    if codec.lsb == 0.0:  # a float
        return np.array([codec.quantise(value) for value in values.tolist()])
    received = raw_values(codec, values).astype(np.float64) * codec.lsb
    received[np.isnan(values)] = np.nan
    return received
