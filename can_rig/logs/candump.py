"""candump logs, plain or gzipped, read in blocks of bytes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

from can_rig.errors import LogError
from can_rig.logs.blocks import blocks
from can_rig.logs.candump_lines import BAD_LINE, NEW_CHANNEL, WIDER, parse
from can_rig.logs.frames import CLASSIC_BYTES, FD_BYTES, Frames

if TYPE_CHECKING:
    from can_rig.logs.reading import Log

MOST_CHANNELS: Final = 255
_LONGEST_LINE: Final = 4096  # bytes; one of an FD frame has some 170
_WHOLE: Final = re.compile(rb"[ \t][RrTt][ \t\r]*$")  # a line cannot go on after its direction
_SHOWN: Final = 60  # characters of a bad line


def read_candump(log: Log) -> Iterator[Frames]:
    """Chunks of a candump log. A last line that was still being written is not read but noted.

    Raises:
        LogError: a line is not candump's; file and line number.
    """
    reader = _Reader(log)
    tail = b""
    for block in blocks(log):
        text = tail + block
        end = text.rfind(b"\n") + 1
        tail = text[end:]
        yield from reader.read(text[:end])
        if len(tail) > _LONGEST_LINE:
            reader.refuse(tail)
    if tail.strip():
        yield from reader.read_unfinished(tail)


class _Reader:
    """Channels and line numbers from block to block."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._lines = 0  # before the line at hand
        self._frames = 0
        self._channels: list[bytes] = []
        self._width = CLASSIC_BYTES

    def read(self, text: bytes) -> Iterator[Frames]:
        """The frames of whole lines."""
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
        """What a recorder that was stopped in the middle left behind the last newline."""
        try:
            if _WHOLE.search(tail):
                yield from self.read(tail + b"\n")
                return
        except LogError:
            pass
        if not self._frames and b"#" not in tail and len(tail) > _SHOWN:
            self.refuse(tail)  # it never was a log
        self._log.notice = (
            f"{self._log.path}: line {self._lines + 1}: the file ends within this line, "
            f"which is not read: {_shown(tail)}"
        )

    def refuse(self, line: bytes) -> None:
        """Say that the line behind those counted is not candump's."""
        raise LogError(
            f"{self._log.path}: line {self._lines + 1}: not a frame as candump -L writes it: "
            f"{_shown(line)}"
        )

    def _room(self, text_bytes: int) -> Frames:
        """Columns to be filled, as long as so much text can need."""
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
        if len(self._channels) == MOST_CHANNELS:
            raise LogError(
                f"{self._log.path}: line {self._lines + 1}: the {MOST_CHANNELS + 1}th bus; "
                f"a log of at most {MOST_CHANNELS} can be read"
            )
        self._channels.append(text[at : text.index(b"\n", at)].split()[1])


def _word(name: bytes) -> str:
    return name.decode("ascii", "backslashreplace")


def _shown(line: bytes) -> str:
    return repr(_word(line[:_SHOWN].strip()))
