"""Vector binary logs: containers of objects, usually compressed."""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from typing import BinaryIO, Final, NoReturn

import numpy as np

from can_rig.errors import LogError
from can_rig.logs.frames import CLASSIC_BYTES, FD_BYTES, Frames
from can_rig.logs.log import Log
from can_rig.logs.readers.binary.blf_objects import BAD_TIME, BASE_BYTES, NO_OBJECT, WIDER, parse
from can_rig.logs.readers.binary.inflate import InflateError, inflated
from can_rig.logs.readers.numbering import numbered

SIGNATURE: Final = b"LOGG"

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


def read_blf(log: Log) -> Iterator[Frames]:
    """Chunks of a Vector binary log.

    Raises:
        LogError: not a Vector binary log, or damaged.
    """
    try:
        with log.path.open("rb") as file:
            yield from _Reader(log, file).read()
    except OSError as error:
        raise LogError(f"{log.path}: cannot be read: {error.strerror}") from None


class _Reader:
    def __init__(self, log: Log, file: BinaryIO) -> None:
        self._log, self._file = log, file
        self._size = log.path.stat().st_size
        self._at = 0  # of the object, or of the first of several containers, under way in the file
        self._frames = 0
        self._width = CLASSIC_BYTES

    def read(self) -> Iterator[Frames]:
        raw = self._file.read(_HEADER.size)
        if len(raw) < _HEADER.size or not raw.startswith(SIGNATURE):
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
            raw = self._file.read(BASE_BYTES)
            if len(raw) < BASE_BYTES:
                return b""
            signature, header, _, size, kind = _OBJECT.unpack(raw)
            if signature != b"LOBJ" or size < max(header, BASE_BYTES) or size > _MOST_BYTES:
                self._refuse("no object (LOBJ) of a plausible size begins here")
            body = self._file.read(size - BASE_BYTES)
            if len(body) == size - BASE_BYTES:
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
            room = Frames(
                np.empty(rows, np.int64),
                np.empty(rows, np.uint32),
                np.empty(rows, np.uint8),
                np.empty(rows, np.uint16),  # renumbered below
                np.empty(rows, np.uint8),
                np.empty((rows, self._width), np.uint8),
                (),
            )
            count, at, why = parse(
                codes,
                at,
                room.time_ns,
                room.arbitration_id,
                room.flags,
                room.channel,
                room.length,
                room.data,
            )
            if count:
                self._frames += count
                frames = numbered(room[:count], first=1)
                yield replace(frames, time_ns=frames.time_ns + self._log.start_ns)
            if why == NO_OBJECT:
                self._refuse(f"what is unpacked from here on has no whole object at byte {at}")
            if why == BAD_TIME:
                self._refuse(f"what is unpacked from here on is after the year 2116 at byte {at}")
            if why == WIDER:
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
