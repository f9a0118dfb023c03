"""candump logs, plain or gzipped; a cut-off end is noted."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

import numpy as np

from can_rig.errors import LogError
from can_rig.logs.frames import CLASSIC_BYTES, FD, FD_BYTES, Frames, UInt8s
from can_rig.logs.log import Log
from can_rig.logs.readers.numbering import MAX_CHANNELS
from can_rig.logs.readers.text.formats.candump_lines import parse
from can_rig.logs.readers.text.lines import LineReader, word

_DIRECTION: Final = re.compile(rb"[ \t][RrTt][ \t\r]*$")  # at the end of the line


def read_candump(log: Log) -> Iterator[Frames]:
    """Chunks of a candump log. An unfinished last line is ignored, and noted.

    Raises:
        LogError: a line is not candump's; file and line number.
    """
    begun = False
    for frames in _Reader(log).read():
        if not begun:
            log.start_ns = int(frames.time_ns[0])
            begun = True
        yield frames


class _Reader(LineReader):
    """Knows buses by name."""

    def __init__(self, log: Log) -> None:
        super().__init__(log, self._parsed, "a frame as candump -L writes it")
        self._channels: list[bytes] = []

    def _parsed(self, text: UInt8s, at: int, room: Frames) -> tuple[int, int, int, int]:
        names = np.frombuffer(b"".join(self._channels), dtype=np.uint8)
        ends = np.cumsum([len(name) for name in self._channels], dtype=np.int64)
        return parse(
            text,
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

    def ended(self, line: bytes, frame: Frames) -> bool:
        """A direction or, where the line before has none, as many bytes as a frame can have."""
        if _DIRECTION.search(line) or _DIRECTION.search(self.before):
            return bool(_DIRECTION.search(line))
        return int(frame.length[-1]) == (FD_BYTES if frame.flags[-1] & FD else CLASSIC_BYTES)

    def add_channel(self, line: bytes) -> None:
        """The second word of the line.

        Raises:
            LogError: too many channels.
        """
        if len(self._channels) == MAX_CHANNELS:
            raise LogError(
                f"{self.place()}: bus number {MAX_CHANNELS + 1}; "
                f"there must be at most {MAX_CHANNELS} buses in a log"
            )
        self._channels.append(line.split()[1])

    def channels(self) -> tuple[str, ...]:
        """In the order of first appearance."""
        return tuple(map(word, self._channels))
