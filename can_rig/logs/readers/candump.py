"""candump logs, plain or gzipped, read in blocks of bytes; a cut-off end is noted."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

import numpy as np

from can_rig.errors import LogError
from can_rig.logs.frames import CLASSIC_BYTES, FD_BYTES, Frames
from can_rig.logs.log import Log
from can_rig.logs.readers.blocks import blocks
from can_rig.logs.readers.candump_lines import BAD_LINE, NEW_CHANNEL, WIDER, parse

MAX_CHANNELS: Final = 255
_MAX_LINE_BYTES: Final = 4096  # a line of an FD frame has some 170
_COMPLETE: Final = re.compile(rb"[ \t][RrTt][ \t\r]*$")  # nothing follows the direction
_SHOWN: Final = 60  # characters of a bad line


def read_candump(log: Log) -> Iterator[Frames]:
    """Chunks of a candump log. An unfinished last line is ignored, and noted.

    Raises:
        LogError: a line is not one of candump's; file and line number.
    """
    reader = _Reader(log)
    tail = b""
    for block in blocks(log):
        text = tail + block
        end = text.rfind(b"\n") + 1
        tail = text[end:]
        yield from reader.read(text[:end])
        if len(tail) > _MAX_LINE_BYTES:
            reader.refuse(tail)
    if tail.strip():
        yield from reader.read_unfinished(tail)


class _Reader:
    """Keeps the channels and the number of the line from block to block."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._lines = 0  # before the one being read
        self._frames = 0
        self._channels: list[bytes] = []
        self._width = CLASSIC_BYTES

    def read(self, text: bytes) -> Iterator[Frames]:
        """The frames of complete lines."""
        at = 0
        while at < len(text):
            room = self._room(len(text) - at)
            names = np.frombuffer(b"".join(self._channels), dtype=np.uint8)
            ends = np.cumsum([len(name) for name in self._channels], dtype=np.int64)
            count, lines, at, why = parse(
                np.frombuffer(text, np.uint8),
                at,
                names,
                ends,
                room.time_ns,
                room.arbitration_id,
                room.flags,
                room.channel,
                room.length,
                room.data,
            )
            self._lines += lines
            if count:
                frames = room[:count]
                if not self._frames:
                    self._log.start_ns = int(frames.time_ns[0])
                self._frames += count
                yield frames
            if why == BAD_LINE:
                self.refuse(text[at : text.index(b"\n", at)])
            if why == NEW_CHANNEL:
                self._add_channel(text, at)
            if why == WIDER:
                self._width = FD_BYTES

    def read_unfinished(self, tail: bytes) -> Iterator[Frames]:
        """The text after the last newline, where a recorder was stopped in the middle of a line."""
        try:
            if _COMPLETE.search(tail):
                yield from self.read(tail + b"\n")
                return
        except LogError:
            pass
        if not self._frames and b"#" not in tail and len(tail) > _SHOWN:
            self.refuse(tail)  # it has never been a log
        self._log.notice = (
            f"{self._log.path}: line {self._lines + 1}: the file ends within this line, "
            f"which is ignored: {_shown(tail)}"
        )

    def refuse(self, line: bytes) -> None:
        """Raise the error for the line after those counted."""
        raise LogError(
            f"{self._log.path}: line {self._lines + 1}: not a frame as candump -L writes it: "
            f"{_shown(line)}"
        )

    def _room(self, text_bytes: int) -> Frames:
        """Columns to be filled, with a row for every frame that so much text can hold."""
        rows = min(self._log.chunk_frames, text_bytes // len(b"(0) c 1#\n") + 1)
        return Frames(
            np.empty(rows, np.int64),
            np.empty(rows, np.uint32),
            np.empty(rows, np.uint8),
            np.empty(rows, np.uint8),
            np.empty(rows, np.uint8),
            np.empty((rows, self._width), np.uint8),
            tuple(map(_word, self._channels)),
        )

    def _add_channel(self, text: bytes, at: int) -> None:
        if len(self._channels) == MAX_CHANNELS:
            raise LogError(
                f"{self._log.path}: line {self._lines + 1}: bus number {MAX_CHANNELS + 1}; "
                f"there must be at most {MAX_CHANNELS} buses in a log"
            )
        self._channels.append(text[at : text.index(b"\n", at)].split()[1])


def _word(name: bytes) -> str:
    return name.decode("ascii", "backslashreplace")


def _shown(line: bytes) -> str:
    return repr(_word(line[:_SHOWN].strip()))
