"""Vector binary logs: containers of objects, usually compressed.

An object: "LOBJ", size of its header, version of it, size of the object, type (16 bytes); then
flags, which tell the unit of time, and a time stamp. Only CAN frame types are read, by compiled
code in one pass over the bytes; other types are skipped. Source: Vector, "binlog" API,
`binlog_objects.h`. Logs are written by python-can, with time stamps in seconds since the start of
the recording, not since 1970: float64 keeps them exact.
"""

import re
import struct
from collections.abc import Generator, Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO, Final, NoReturn

import numpy as np
from can.io import BLFWriter

from can_rig.errors import LogError
from can_rig.logs import scan
from can_rig.logs.compression import InflateError, inflated
from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    FD_BYTES,
    NS_PER_S,
    REMOTE,
    SENT,
    Columns,
    Format,
    Frames,
    Log,
    UInt8s,
    empty_columns,
    numbered,
)
from firmware_model.compiled import compiled

_SIGNATURE: Final = b"LOGG"
_HEADER: Final = struct.Struct("<4sL8BQQLL8H8H")  # signature, size, …, file size, …, start, stop
_FILE_SIZE, _OBJECTS, _START = 10, 12, slice(14, 22)
_OBJECT: Final = struct.Struct("<4sHHLL")
_CONTAINER: Final = struct.Struct("<H6xL4x")  # compression, size of the content
_CONTAINER_TYPE: Final = 10
_STORED, _ZLIB = 0, 2
_BLOCK_BYTES: Final = 1 << 22
_MOST_BYTES: Final = 1 << 28
"""Of an object, which bounds the memory; Vector's containers have 128 KiB."""
_SHORTEST_FRAME: Final = 48
_PADDING_BYTES: Final = 1 << 12
_HALF_NS: Final = 5e-10  # python-can's writer cuts off what is below 1 ns
_MORE: Final = 0
"""Why `_objects` returned: the next object is incomplete, or the columns are full."""
_NO_OBJECT: Final = 1
"""The bytes are no object, or the object is shorter than its payload."""
_BAD_TIME: Final = 2
"""A time stamp beyond the year 2116."""
_WIDER: Final = 3
"""A payload longer than the rows of ``data``."""

_BASE_BYTES: Final = 16
_PADDING = 8  # bytes at most between two objects
_MESSAGE, _ERROR_EXT, _MESSAGE_2, _FD_MESSAGE, _FD_MESSAGE_64 = 1, 73, 86, 100, 101
_LOBJ = int.from_bytes(b"LOBJ", "little")
_TEN_US = 1
_LAST_NS = 1 << 62
_ID_MASK, _EXTENDED_SHIFT = (1 << 29) - 1, 31


@compiled
def _objects(data: UInt8s, at: int, columns: Columns) -> tuple[int, int, int]:
    """Fill the columns from the objects that begin at ``at``, after zeros or up to 8 bytes later.

    ``columns.channel`` gets numbers of buses, from 1. Returns the number of frames, where the next
    object begins, and why it stopped there.
    """
    frames = 0
    end = len(data)
    while frames < len(columns.time_ns):
        while at < end and data[at] == 0:  # at the end of a container may be as many as you like
            at += 1
        begin = _next_object(data, at)
        if begin < 0:
            return frames, at, _MORE if at + _PADDING > end else _NO_OBJECT
        if begin + _BASE_BYTES > end:
            return frames, at, _MORE
        header, version = _u16(data, begin + 4), _u16(data, begin + 6)
        size, kind = _u32(data, begin + 8), _u32(data, begin + 12)
        if header < _BASE_BYTES or size < header:
            return frames, begin, _NO_OBJECT
        if begin + size > end:
            return frames, at, _MORE
        row = columns.data[frames]
        least = 40 if version == 2 else 32
        body = begin + header
        if version in (1, 2) and size >= least and header >= least and _least_bytes(kind):
            stamp = _u64(data, begin + 24)
            unit = 10_000 if _u32(data, begin + 16) == _TEN_US else 1
            if not 0 <= stamp <= _LAST_NS // unit:
                return frames, begin, _BAD_TIME
            if body + _least_bytes(kind) > begin + size:
                return frames, begin, _NO_OBJECT
            bits, bus, identifier, count = _frame(data, kind, body, begin + size, header, row)
            if count > len(row):
                return frames, at, _WIDER
            columns.time_ns[frames] = stamp * unit
            columns.arbitration_id[frames] = identifier & _ID_MASK
            columns.flags[frames] = bits | EXTENDED * (identifier >> _EXTENDED_SHIFT)
            columns.channel[frames] = bus
            columns.length[frames] = count
            frames += 1
        at = begin + size
    return frames, at, _MORE


@compiled
def _least_bytes(kind: int) -> int:
    """Bytes after the header that an object must have; 0 for objects without a frame."""
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
        size = _u8(scan.BYTES_OF_DLC, min(dlc, len(scan.BYTES_OF_DLC) - 1))
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
        if _u32(data, begin) == _LOBJ:
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


def _read(log: Log) -> Iterator[Frames]:
    """Chunks of a Vector binary log.

    Raises:
        LogError: not a Vector binary log, or damaged.
    """
    with log.path.open("rb") as file:
        yield from _Reader(log, file).read()


class _Reader:
    def __init__(self, log: Log, file: BinaryIO) -> None:
        self._log, self._file = log, file
        self._size = log.path.stat().st_size
        self._at = 0  # of the object, or of the first of several containers, under way in the file
        self._frames = 0
        self._width = CLASSIC_BYTES

    def read(self) -> Iterator[Frames]:
        raw = self._file.read(_HEADER.size)
        if len(raw) < _HEADER.size or not raw.startswith(_SIGNATURE):
            raise LogError(f"{self._log.path}: not a Vector binary log: it must begin with LOGG")
        header = _HEADER.unpack(raw)
        self._log.start_ns = _start_ns(header[_START])
        self._file.seek(header[1])
        self._at = header[1]
        rest = b""
        for block in self._blocks():
            data = rest + block
            at = yield from self._objects(data)
            rest = data[at:]
        if self._size < header[_FILE_SIZE]:
            self._log.notice = (
                f"{self._log.path}: is cut off after {self._size} of {header[_FILE_SIZE]} bytes; "
                "its last frames are missing"
            )
        elif not header[_OBJECTS] and self._frames:
            self._log.notice = (
                f"{self._log.path}: was never closed by its recorder; its last frames are missing"
            )

    def _blocks(self) -> Iterator[bytes]:
        """The contents of the containers, several containers at a time."""
        held: list[bytes] = []
        begin = self._at
        while content := self._object():
            held.append(content)
            if sum(map(len, held)) >= _BLOCK_BYTES:
                self._at = begin
                yield b"".join(held)
                held.clear()
                begin = self._file.tell()
            self._log.fraction = min(self._file.tell() / max(self._size, 1), 1.0)
        self._at = begin
        yield b"".join(held)

    def _object(self) -> bytes:
        """The content of the next container, or an object outside containers; empty at the end."""
        while True:
            self._skip_zeros()
            self._at = self._file.tell()
            raw = self._file.read(_BASE_BYTES)
            if len(raw) < _BASE_BYTES:
                return b""
            signature, header, _, size, kind = _OBJECT.unpack(raw)
            if signature != b"LOBJ" or size < max(header, _BASE_BYTES) or size > _MOST_BYTES:
                self._refuse("no object (LOBJ) of a plausible size begins here")
            body = self._file.read(size - _BASE_BYTES)
            if len(body) == size - _BASE_BYTES:
                self._file.seek(size % 4, 1)  # padding
            content = self._content(body) if kind == _CONTAINER_TYPE else raw + body
            if content:
                return content

    def _skip_zeros(self) -> None:
        """Pass over room that the recorder did not use."""
        while piece := self._file.read(_PADDING_BYTES):
            rest = piece.lstrip(b"\0")
            if rest:
                self._file.seek(-len(rest), 1)
                return

    def _content(self, body: bytes) -> bytes:
        if len(body) < _CONTAINER.size:
            return b""  # cut off
        method, size = _CONTAINER.unpack_from(body)
        packed = body[_CONTAINER.size :]
        if method == _STORED:
            return packed
        if method != _ZLIB:
            self._refuse(f"unknown compression {method}; it must be 0 or 2")
        try:
            return inflated(packed, min(size, _MOST_BYTES))
        except InflateError as error:
            self._refuse(str(error))

    def _objects(self, data: bytes) -> Generator[Frames, None, int]:
        """The frames of all complete objects; returns the position of the first incomplete one."""
        codes = np.frombuffer(data, np.uint8)
        at = 0
        while True:
            rows = min(self._log.chunk_frames, (len(data) - at) // _SHORTEST_FRAME + 1)
            room = empty_columns(rows, self._width, np.uint16)  # bus numbers become indices below
            count, at, why = _objects(codes, at, room)
            if count:
                self._frames += count
                frames = numbered(room.frames(count), first=1)
                yield replace(frames, time_ns=frames.time_ns + self._log.start_ns)
            if why == _NO_OBJECT:
                self._refuse(f"what is unpacked from here on has no whole object at byte {at}")
            if why == _BAD_TIME:
                self._refuse(f"what is unpacked from here on is after the year 2116 at byte {at}")
            if why == _WIDER:
                self._width = FD_BYTES
            elif count < rows:
                return at

    def _refuse(self, why: str) -> NoReturn:
        raise LogError(f"{self._log.path}: byte {self._at}: does not follow the format: {why}")


def _start_ns(systemtime: tuple[int, ...]) -> int:
    """A Windows SYSTEMTIME (year, month, weekday, day, …, ms) [ns]; 0 for an invalid date."""
    year, month, _, day, hour, minute, second, ms = systemtime
    try:
        start = datetime(year, month, day, hour, minute, second, ms * 1000, UTC)
    except ValueError:
        return 0
    start_ns = round(start.timestamp() * 1000) * 1_000_000
    return start_ns if abs(start_ns) < 1 << 62 else 0


def _write(chunks: Iterable[Frames], path: Path, start_ns: int, _final: Path) -> None:
    with BLFWriter(path) as writer:
        writer.start_timestamp = last_s = 0.0
        for frames in chunks:
            for message in frames.messages(start_ns):
                last_s = message.timestamp
                message.timestamp += _HALF_NS
                writer.on_message_received(message)
        writer.start_timestamp = start_ns / NS_PER_S
        writer.stop_timestamp = writer.start_timestamp + last_s


VECTOR_BINARY: Final = Format(
    key=".blf",
    mark=re.compile(_SIGNATURE),
    read=_read,
    gzipped=False,
    write=_write,
    name="a Vector binary log",
    start_ns=1_000_000,
    since_ns=631_152_000 * NS_PER_S,  # the year 1990
    before_start=False,
    error_direction=False,
)
