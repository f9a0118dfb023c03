"""The lines of a text log, given to a compiled parser: header, numbers of lines, a cut-off end."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Final, NoReturn

import numpy as np

from can_rig.errors import LogError
from can_rig.logs.frames import CLASSIC_BYTES, FD_BYTES, Frames, UInt8s
from can_rig.logs.log import Log
from can_rig.logs.readers.text.blocks import blocks
from can_rig.logs.readers.text.scanning import BAD_LINE, HEADING, NEW_CHANNEL, WIDER

_MAX_LINE_BYTES: Final = 1 << 16
_SHORTEST_FRAME: Final = len(b"(0) c 1#\n")
_END_BYTES: Final = 1 << 10  # size of the block at the end, searched for the last lines
_SHOWN: Final = 60  # characters of a bad line

Parse = Callable[[UInt8s, int, Frames], tuple[int, int, int, int]]
"""(text, position, columns to fill) → frames, lines, position of the next line, why it stopped."""


class LineReader:
    """Common part of the text readers; a subclass adds the details of its format.

    Args:
        log: the log.
        parse: fills columns from lines; text that has not the form of a frame is passed over.
        wanted: description of a correct line, as in "a valid frame".
    """

    first_frame: re.Pattern[bytes] | None = None
    """Matches the line of a frame; the lines before the first match are the header. None: no
    header."""

    def __init__(self, log: Log, parse: Parse, wanted: str = "a valid frame") -> None:
        self.log = log
        self.header: list[str] = []
        """Lines before the first frame, without blank ones."""
        self.last = self.before = b""
        """The last two lines that are not blank, the last line first."""
        self.frames = 0
        """Frames so far."""
        self._parse = parse
        self._wanted = wanted
        self._lines = 0  # lines before the current line
        self._in_header = self.first_frame is not None
        self._width = CLASSIC_BYTES

    def begin(self) -> None:
        """Make use of the header: called once, before the first frame or at the end."""

    def add_channel(self, line: bytes) -> None:
        """Make a new bus known to the parser: the bus of the line."""

    def heading(self, line: bytes) -> None:
        """Interpret a heading, which may change how later lines are read."""

    def ended(self, line: bytes, frame: Frames) -> bool:
        """Whether a last line without its newline is complete."""
        raise NotImplementedError

    def ignorable(self, line: bytes) -> bool:
        """Whether a last line without a frame is complete."""
        return False

    def blocks(self) -> Iterator[bytes]:
        """The text, whose lines end with a newline."""
        return blocks(self.log)

    def read(self) -> Iterator[Frames]:
        """Chunks of the log.

        Raises:
            LogError: a line looks like a frame but is not valid; file and line number.
        """
        tail = b""
        for block in self.blocks():
            text = tail + block
            end = text.rfind(b"\n") + 1
            tail = text[end:]
            yield from self._whole_lines(text[:end])
            if len(tail) > _MAX_LINE_BYTES:
                self.refuse(tail)
        if tail.strip():
            yield from self._unfinished(tail)
        if self._in_header:
            self._begin()

    def refuse(self, line: bytes) -> NoReturn:
        """Raise the error for the line after those counted."""
        raise LogError(f"{self.place()}: not {self._wanted}: {shown(line)}")

    def place(self) -> str:
        """The file and the line after those counted."""
        return f"{self.log.path}: line {self._lines + 1}"

    def _whole_lines(self, text: bytes) -> Iterator[Frames]:
        at = self._header_end(text) if self._in_header else 0
        codes = np.frombuffer(text, np.uint8)
        while at < len(text):
            room = self._room(len(text) - at)
            count, lines, at, why = self._parse(codes, at, room)
            self._lines += lines
            if count:
                self.frames += count
                yield room[:count]
            if why == BAD_LINE:
                self.refuse(text[at : text.index(b"\n", at)])
            if why == NEW_CHANNEL:
                self.add_channel(text[at : text.index(b"\n", at)])
            if why == HEADING:
                end = text.index(b"\n", at)
                self.heading(text[at:end].strip())
                self._lines += 1
                at = end + 1
            if why == WIDER:
                self._width = FD_BYTES
        *before, last = text[-_END_BYTES:].rstrip().splitlines() or [b""]
        if last:
            self.before, self.last = before[-1] if before else self.last, last

    def _header_end(self, text: bytes) -> int:
        """Where the first frame begins, after the header has been taken."""
        assert self.first_frame is not None
        at = 0
        while at < len(text):
            end = text.index(b"\n", at) + 1
            if self.first_frame.match(text, at, end):
                self._begin()
                break
            line = text[at:end].strip()
            if line:
                self.header.append(line.decode("utf-8", "replace"))
            self._lines += 1
            at = end
        return at

    def _begin(self) -> None:
        self._in_header = False
        self.begin()

    def _unfinished(self, tail: bytes) -> Iterator[Frames]:
        """The text after the last newline, where a recorder was stopped in the middle of a line."""
        place, before = self.place(), self.frames
        if self.ignorable(tail):
            self.last = tail
            return
        try:
            found = list(self._whole_lines(tail + b"\n"))
        except LogError:
            found = []
        if found and self.ended(tail, found[-1]):
            yield from found
            return
        if not before and not self.header and b"#" not in tail and len(tail) > _SHOWN:
            self._lines = 0
            self.refuse(tail)  # the text was never a log
        self.log.notice = (
            f"{place}: the file ends within this line, which is ignored: {shown(tail)}"
        )

    def _room(self, text_bytes: int) -> Frames:
        """Columns to be filled, with a row for every frame that so much text can hold."""
        rows = min(self.log.chunk_frames, text_bytes // _SHORTEST_FRAME + 1)
        return Frames(
            np.empty(rows, np.int64),
            np.empty(rows, np.uint32),
            np.empty(rows, np.uint8),
            np.empty(rows, np.uint8),
            np.empty(rows, np.uint8),
            np.empty((rows, self._width), np.uint8),
            self.channels(),
        )

    def channels(self) -> tuple[str, ...]:
        """The names of the known buses; empty if the format uses numbers."""
        return ()


def word(name: bytes) -> str:
    """Bytes of a log in print."""
    return name.decode("ascii", "backslashreplace")


def shown(line: bytes) -> str:
    """The beginning of a line in print."""
    return repr(word(line[:_SHOWN].strip()))
