"""Text logs: their bytes in blocks, plain or gzipped, and the common part of their readers.

A format is a subclass of `TextReader`, with a function for one line (`scan.Line`).
"""

import re
import zlib
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import ClassVar, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.logs import scan
from can_rig.logs.frames import (
    CLASSIC_BYTES,
    FD_BYTES,
    REMOTE,
    Frames,
    Log,
    empty_columns,
    numbered,
)

BLOCK_BYTES: Final = 1 << 22
LAST_NS: Final = (1 << 63) - 1
"""In the year 2262."""
_MAX_LINE_BYTES: Final = 1 << 16
_SHORTEST_FRAME: Final = len(b"(0) c 1#\n")
_END_BYTES: Final = 1 << 10  # size of the block at the end, searched for the last lines
_SHOWN: Final = 60  # characters of a bad line
_WHOLE: Final = re.compile(rb"(\s|\s[0-9A-Fa-f]{2})\Z")
_MAGIC: Final = b"\x1f\x8b"  # first bytes of every gzipped file
_GZIP: Final = 16 + zlib.MAX_WBITS


class TextReader:
    """Common part of the text readers; a subclass adds the details of its format."""

    parse: ClassVar[scan.Parse]
    """Fills columns from lines; text that has not the form of a frame is passed over."""
    wanted: ClassVar[str] = "a valid frame"
    """Description of a correct line."""
    first_frame: ClassVar[re.Pattern[bytes] | None] = None
    """Matches the line of a frame; the lines before the first match are the header. None: no
    header."""
    has_date = True
    """Whether ``begin`` or ``heading`` set the start; else the log starts with its first frame."""
    first_bus = 0
    """The number of the first bus in the text."""

    def __init__(self, log: Log) -> None:
        self.log = log
        self.settings: NDArray[np.int64] = np.zeros(0, np.int64)
        """What ``parse`` needs to know of the file."""
        self.zero_ns = 0
        """Added to the time stamps of the lines."""
        self.header: list[str] = []
        """Lines before the first frame, without blank ones."""
        self.last = self.before = b""
        """The last two lines that are not blank, the last line first."""
        self.frames = 0
        """Frames so far."""
        self._lines = 0  # lines before the current line
        self._in_header = self.first_frame is not None
        self._width = CLASSIC_BYTES

    @classmethod
    def of(cls, log: Log) -> Iterator[Frames]:
        """Chunks of ``log``.

        Raises:
            LogError: another format, or a line looks like a frame but is not valid; file and line
                number.
        """
        reader = cls(log)
        for number, found in enumerate(reader._chunks()):
            time_ns = reader.counted(found.time_ns)
            if number == 0 and not reader.has_date:
                log.start_ns = int(time_ns[0])
            last_ns = int(time_ns.max())
            if last_ns > LAST_NS - reader.zero_ns:
                raise LogError(
                    f"{log.path}: a time stamp of {last_ns / 1e9:.3g} s after the start; "
                    "it must be before the year 2262"
                )
            on_clock = replace(found, time_ns=time_ns + reader.zero_ns)
            yield on_clock if found.channels else numbered(on_clock, reader.first_bus)
        reader.finish()

    def begin(self) -> None:
        """Make use of the header: called once, before the first frame or at the end."""

    def finish(self) -> None:
        """Refuse or note what only the end of the log tells."""

    def add_bus(self, line: bytes) -> None:
        """Make a new bus known to the parser: the bus of the line."""

    def heading(self, line: bytes) -> None:
        """Interpret a heading, which may change how later lines are read.

        Here: the heading of a second log, whose times count from another start.

        Raises:
            LogError: a second log.
        """
        raise LogError(
            f"{self.place()}: a second log begins here: {shown(line)}; must be a file of its own"
        )

    def counted(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """The time stamps of the next lines, where the clock of a format begins anew."""
        return time_ns

    def ended(self, line: bytes, frame: Frames) -> bool:
        """Whether a last line without its newline is complete.

        Here: all announced bytes are present, the last byte with both digits.
        """
        data = frame.length[-1] > 0 and not frame.flags[-1] & REMOTE
        return bool(_WHOLE.search(line)) and bool(data or line[-1:].isspace())

    def ignorable(self, line: bytes) -> bool:
        """Whether a last line without a frame is complete."""
        return False

    def blocks(self) -> Iterator[bytes]:
        """The text, whose lines end with a newline."""
        return _blocks(self.log)

    def plain(self, text: bytes) -> bytes:
        """Whole lines as ``parse`` takes them, each of the same number of bytes or fewer."""
        return text

    def bus_names(self) -> tuple[str, ...]:
        """The names of the known buses; empty if the format has numbers."""
        return ()

    def place(self) -> str:
        """The file and the line after those counted."""
        return f"{self.log.path}: line {self._lines + 1}"

    def refuse(self, line: bytes) -> NoReturn:
        """Raise the error for the line after those counted."""
        raise LogError(f"{self.place()}: not {self.wanted}: {shown(line)}")

    def _chunks(self) -> Iterator[Frames]:
        """The frames, with the time stamps and the buses of the text."""
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

    def _whole_lines(self, text: bytes) -> Iterator[Frames]:
        text = self.plain(text)
        at = self._header_end(text) if self._in_header else 0
        codes = np.frombuffer(text, np.uint8)
        while at < len(text):
            rows = min(self.log.chunk_frames, (len(text) - at) // _SHORTEST_FRAME + 1)
            room = empty_columns(rows, self._width)
            count, lines, at, why = type(self).parse(codes, at, self.settings, room)
            self._lines += lines
            if count:
                self.frames += count
                yield room.frames(count, self.bus_names())
            if why in (scan.BAD_LINE, scan.NEW_BUS, scan.HEADING):
                end = text.index(b"\n", at)
                if why == scan.BAD_LINE:
                    self.refuse(text[at:end])
                elif why == scan.NEW_BUS:
                    self.add_bus(text[at:end])
                else:
                    self.heading(text[at:end].strip())
                    self._lines += 1
                    at = end + 1
            if why == scan.WIDER:
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


def word(name: bytes) -> str:
    """Bytes of a log in print."""
    return name.decode("ascii", "backslashreplace")


def shown(line: bytes) -> str:
    """The beginning of a line in print."""
    return repr(word(line[:_SHOWN].strip()))


def _blocks(log: Log) -> Iterator[bytes]:
    """The text of ``log`` in blocks of bounded size; keeps ``log.fraction``.

    A truncated gzipped file yields its intact text, and a notice.

    Raises:
        LogError: the file cannot be decompressed.
    """
    packed = _file_blocks(log)
    first = next(packed, b"")
    every = chain([first], packed)
    is_packed = first.startswith(_MAGIC) or log.path.suffix.lower() == ".gz"
    return _decompressed(log, every) if is_packed else every


def _file_blocks(log: Log) -> Iterator[bytes]:
    with log.path.open("rb") as file:
        size = log.path.stat().st_size
        done = 0
        while block := file.read(BLOCK_BYTES):
            done += len(block)
            yield block
            log.fraction = min(done / size, 1.0) if size else 0.0  # a pipe has no size


def _decompressed(log: Log, packed: Iterator[bytes]) -> Iterator[bytes]:
    """All members of a gzip file in a row, as ``gunzip`` gives them."""
    member = zlib.decompressobj(_GZIP)
    begun = False
    offset = 0  # position of the block in the file
    for block in packed:
        rest = block
        while rest:
            try:
                text = member.decompress(rest, BLOCK_BYTES)
            except zlib.error as error:
                raise LogError(
                    f"{log.path}: not a gzip file, or damaged in the {len(block)} bytes from byte "
                    f"{offset}: {error}"
                ) from None
            begun = True
            if text:
                yield text
            rest = member.unconsumed_tail
            if member.eof:
                rest = member.unused_data.lstrip(b"\0")  # zeros may pad the end
                member, begun = zlib.decompressobj(_GZIP), False
        offset += len(block)
    if begun:
        yield member.flush()
        log.notice = f"{log.path}: the compressed file is cut off; its last frames are missing"
