"""The objects of a Vector binary log → columns, compiled: one pass over the bytes.

An object: "LOBJ", size of its header, version of it, size of the object, type (16 bytes); then
flags, which tell the unit of time, and a time stamp. Only CAN frame types are read; other types are
skipped. Source: Vector, "binlog" API, `binlog_objects.h`.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    REMOTE,
    SENT,
    UInt8s,
)
from can_rig.logs.readers.text.scanning import BYTES_OF_DLC
from firmware_model.compiled import compiled

MORE: Final = 0
"""Why `parse` returned: the next object is incomplete, or the columns are full."""
NO_OBJECT: Final = 1
"""The bytes are no object, or the object is shorter than its payload."""
BAD_TIME: Final = 2
"""A time stamp beyond the year 2116."""
WIDER: Final = 3
"""A payload longer than the rows of ``data``."""

BASE_BYTES: Final = 16
_PADDING = 8  # bytes at most between two objects
_MESSAGE, _ERROR_EXT, _MESSAGE_2, _FD_MESSAGE, _FD_MESSAGE_64 = 1, 73, 86, 100, 101
_L, _O, _B, _J = 76, 79, 66, 74
_TEN_US = 1
_LAST_NS = 1 << 62
_ID_MASK, _EXTENDED_SHIFT = (1 << 29) - 1, 31


@compiled
def parse(
    data: UInt8s,
    at: int,
    time_ns: Any,
    arbitration_id: Any,
    flags: UInt8s,
    channel: UInt8s,
    length: UInt8s,
    payload: UInt8s,
) -> tuple[int, int, int]:
    """Fill the columns from the objects that begin at ``at``, behind zeros or up to 8 bytes later.

    ``channel`` gets numbers of buses, from 1. Returns the number of frames, where the next object
    begins, and why it stopped there.
    """
    frames = 0
    end = len(data)
    while frames < len(time_ns):
        while at < end and data[at] == 0:  # at the end of a container may be as many as you like
            at += 1
        begin = _next_object(data, at)
        if begin < 0:
            return frames, at, MORE if at + _PADDING > end else NO_OBJECT
        if begin + BASE_BYTES > end:
            return frames, at, MORE
        header, version = _u16(data, begin + 4), _u16(data, begin + 6)
        size, kind = _u32(data, begin + 8), _u32(data, begin + 12)
        if header < BASE_BYTES or size < header:
            return frames, begin, NO_OBJECT
        if begin + size > end:
            return frames, at, MORE
        row = payload[frames]
        least = 40 if version == 2 else 32
        body = begin + header
        if version in (1, 2) and size >= least and header >= least and _least_bytes(kind):
            stamp = _u64(data, begin + 24)
            unit = 10_000 if _u32(data, begin + 16) == _TEN_US else 1
            if not 0 <= stamp <= _LAST_NS // unit:
                return frames, begin, BAD_TIME
            if body + _least_bytes(kind) > begin + size:
                return frames, begin, NO_OBJECT
            bits, bus, identifier, count = _frame(data, kind, body, begin + size, header, row)
            if count > len(row):
                return frames, at, WIDER
            time_ns[frames] = stamp * unit
            arbitration_id[frames] = identifier & _ID_MASK
            flags[frames] = bits | EXTENDED * (identifier >> _EXTENDED_SHIFT)
            channel[frames] = bus
            length[frames] = count
            frames += 1
        at = begin + size
    return frames, at, MORE


@compiled
def _least_bytes(kind: int) -> int:
    """Bytes behind the header that an object must have; 0 for objects without a frame."""
    if kind in (_MESSAGE, _MESSAGE_2):
        return 16
    if kind == _ERROR_EXT:
        return 32
    if kind == _FD_MESSAGE:
        return 20
    return 40 if kind == _FD_MESSAGE_64 else 0


@compiled
def _frame(
    data: UInt8s, kind: int, at: int, end: int, header: int, row: UInt8s
) -> tuple[int, int, int, int]:
    """Flags, bus, identifier and length of the frame at ``at``; its bytes in ``row``."""
    row[:] = 0
    bus, identifier = _u16(data, at), _u32(data, at + 4)
    sent, remote = _u8(data, at + 2) & 1, _u8(data, at + 2) >> 7
    if kind == _ERROR_EXT:
        size = min(_u8(data, at + 10), CLASSIC_BYTES)
        _copy(data, at + 24, size, row)
        return ERROR, bus, _u32(data, at + 16), size
    fd, dlc, begin, there = 0, _u8(data, at + 3), at + 8, CLASSIC_BYTES
    if kind == _FD_MESSAGE:
        marks = _u8(data, at + 13)
        fd = FD * (marks & 1) | BITRATE_SWITCH * (marks >> 1 & 1) | ERROR_STATE * (marks >> 2 & 1)
        begin, there = at + 20, min(_u8(data, at + 14), end - at - 20)
    elif kind == _FD_MESSAGE_64:
        bus, dlc, marks = _u8(data, at), _u8(data, at + 1), _u32(data, at + 12)
        sent, remote = min(_u8(data, at + 34), 1), marks >> 4 & 1
        fd = FD * (marks >> 12 & 1)
        fd |= BITRATE_SWITCH * (marks >> 13 & 1) | ERROR_STATE * (marks >> 14 & 1)
        begin, there = at + 40, min(_u8(data, at + 2), end - at - 40)
        if _u8(data, at + 35):  # something else follows the payload, so far from the object's begin
            there = min(there, _u8(data, at + 35) - header - 40)
    bits = SENT * sent | REMOTE * remote
    size = min(dlc, CLASSIC_BYTES)
    if fd & FD and not remote:  # remote frames are always classic CAN
        bits |= fd
        size = _u8(BYTES_OF_DLC, min(dlc, len(BYTES_OF_DLC) - 1))
    if not remote:
        _copy(data, begin, min(size, there), row)
    return bits, bus, identifier, size


@compiled
def _copy(data: UInt8s, at: int, size: int, row: UInt8s) -> None:
    for byte in range(min(size, len(row))):
        row[byte] = data[at + byte]


@compiled
def _next_object(data: UInt8s, at: int) -> int:
    """Where "LOBJ" is, within the padding; -1: nowhere."""
    for begin in range(at, min(at + _PADDING, len(data)) - 3):
        if (
            data[begin] == _L
            and data[begin + 1] == _O
            and data[begin + 2] == _B
            and data[begin + 3] == _J
        ):
            return begin
    return -1


@compiled
def _u8(data: UInt8s, at: int) -> int:
    return int(np.int64(data[at]))  # int() alone would be unsigned when compiled


@compiled
def _u16(data: UInt8s, at: int) -> int:
    return _u8(data, at) | _u8(data, at + 1) << 8


@compiled
def _u32(data: UInt8s, at: int) -> int:
    return _u16(data, at) | _u16(data, at + 2) << 16


@compiled
def _u64(data: UInt8s, at: int) -> int:
    """As int64: negative from 2**63 on."""
    return _u32(data, at) | _u32(data, at + 4) << 32
