"""Vector's and PEAK's logs through python-can's readers, and what those pass over in silence.

python-can skips a line that it cannot read, and ends without a word where a file is cut off. Here
a line that has the form of a frame but is none is refused, and a missing end is noted.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, Self

from can import Message
from can.io import ASCReader, BLFReader, TRCReader
from can.io.blf import BLFParseError

from can_rig.errors import LogError
from can_rig.logs.blocks import blocks
from can_rig.logs.frames import Frames, from_messages

if TYPE_CHECKING:
    from can_rig.logs.reading import Log

_CHUNK: Final = 1 << 14  # messages of python-can take some 600 bytes each
_SHOWN: Final = 60  # characters of a bad line

_ASC_HEADER: Final = re.compile(r"date\s|base\s|//|begin\s+triggerblock|(no\s+)?internal\s", re.I)
_ASC_FRAME: Final = re.compile(r"\d+\.\d+\s+(\d+\s+\S+\s+(Tx|Rx)\b|\d+\s+ErrorFrame|CANFD\s)", re.I)
_ASC_END: Final = re.compile(r"end\s+triggerblock", re.I)
_TRC_FRAME: Final = re.compile(
    r"\d+\)\s+[\d.]+\s+(\d+\s+)?[RT]x\s"  # versions 1.1 and 1.3
    r"|\d+\)\s+\d+\s+(?!FFFFFFFF)\S{4,8}\s+\d"  # 1.0, whose FFFFFFFF is the state of the bus
    r"|\d+\s+[\d.]+\s+(DT|F[DBE]|BI|RR)\s"  # 2.0 and 2.1
)


def read_asc(log: Log) -> Iterator[Frames]:
    """Chunks of a Vector ASCII log, in the machine's time zone; its end is marked in the file.

    Raises:
        LogError: it is none, or a line of it cannot be read.
    """
    lines = _Lines(log, _ASC_FRAME, "\n")  # python-can's header swallows the first line behind it
    reader = ASCReader(lines.file)
    begun = False
    for chunk in _chunks(lines, reader):
        if not begun:
            log.start_ns = _asc_start(lines.header)
            begun = True
            if reader.timestamps_format == "relative":
                raise LogError(
                    f"{log.path}: its time stamps count from line to line ('timestamps relative'); "
                    "export it with 'timestamps absolute'"
                )
        yield from_messages(chunk, log.start_ns)
    if not begun and not any(_ASC_HEADER.match(line) for line in lines.header):
        raise LogError(f"{log.path}: not a Vector ASCII log: it has no header and no frame")
    has_begin = any(re.match(r"begin\s+triggerblock", line, re.I) for line in lines.header)
    if has_begin and not _ASC_END.match(lines.last):
        lines.note("has no 'End TriggerBlock': its last frames are missing")


def _asc_start(header: list[str]) -> int:
    """When time zero was [ns], 0 if the header does not say so in a way that python-can knows."""
    dated = ASCReader(io.StringIO("\n".join([*header, ""])), relative_timestamp=False)
    try:
        list(dated)
    except ValueError:
        return 0
    return round(dated.start_time * 1e6) * 1000


def read_trc(log: Log) -> Iterator[Frames]:
    """Chunks of a PEAK log; its time stamps are whole microseconds.

    Raises:
        LogError: it is none, or a line of it cannot be read.
    """
    lines = _Lines(log, _TRC_FRAME)
    reader = TRCReader(lines.file)
    begun = False
    start_s = 0.0
    for chunk in _chunks(lines, reader):
        if not begun and reader.start_time is not None:
            start_s = reader.start_time.timestamp()
            log.start_ns = round(start_s * 1e6) * 1000
        begun = True
        for message in chunk:  # python-can has added the start, which float seconds blur
            message.timestamp = round((message.timestamp - start_s) * 1e6) * 1e-6
        yield from_messages(chunk, log.start_ns)
    if not begun and not any(line.startswith(";") for line in lines.header):
        raise LogError(f"{log.path}: not a PEAK log: it has no header and no frame")


def read_blf(log: Log) -> Iterator[Frames]:
    """Chunks of a Vector binary log.

    Raises:
        LogError: it is none, or damaged.
    """
    size = log.path.stat().st_size
    if not size:
        raise LogError(f"{log.path}: is empty; it is not a Vector binary log")
    with _refusing(lambda: f"{log.path}: byte 0"):
        reader = BLFReader(log.path)
    log.start_ns = round(reader.start_timestamp * 1e3) * 1_000_000
    reader.start_timestamp = 0.0  # so that time stamps stay exact: nanoseconds since the start
    frames = 0

    def offset() -> int:
        return size if reader.file.closed else reader.file.tell()

    with reader:
        messages = iter(reader)
        try:
            while chunk := _some(messages, lambda: f"{log.path}: byte {offset()}"):
                frames += len(chunk)
                log.fraction = offset() / size
                yield from_messages(chunk, log.start_ns)
        except _CutOffError:
            pass
    if size < reader.file_size:
        log.notice = (
            f"{log.path}: cut off: it has {size} of {reader.file_size} bytes; "
            "its last frames are missing"
        )
    elif not reader.object_count and frames:
        log.notice = f"{log.path}: was never finished by its recorder; its last frames are missing"


class _CutOffError(Exception):
    """A file ends within an object."""


def _some(messages: Iterator[Message], place: Callable[[], str]) -> list[Message]:
    """The next messages; those before the point where a file is cut off too."""
    found: list[Message] = []
    with _refusing(place):
        try:
            for message in islice(messages, _CHUNK):
                found.append(message)
        except struct.error:
            if not found:
                raise _CutOffError from None
    return found


@contextmanager
def _refusing(place: Callable[[], str]) -> Iterator[None]:
    """What a reader of python-can raises about a file, as one line that begins with the place."""
    try:
        yield
    except OSError as error:
        raise LogError(f"{place()}: cannot be read: {error.strerror}") from None
    except (BLFParseError, ValueError, IndexError, KeyError, struct.error, zlib.error) as error:
        reason = str(error) or type(error).__name__
        raise LogError(f"{place()}: not as its format has it: {reason}") from None


class _Lines:
    """The lines of a text log, as python-can's readers take them; keeps watch on what they skip."""

    def __init__(self, log: Log, frame: re.Pattern[str], end_of_header: str = "") -> None:
        self.header: list[str] = []
        """Lines before the first frame."""
        self.last = ""
        """The last line that is not blank."""
        self.answered = True
        """Whether the line at hand became a message, or need not."""
        self.file: Any = _LineFile(self._watched())
        self._log = log
        self._frame = frame
        self._end_of_header = end_of_header
        self._number = 0

    def place(self) -> str:
        """The line at hand."""
        return f"{self._log.path}: line {self._number}"

    def note(self, what: str) -> None:
        """Note that the end is missing, unless that is noted."""
        self._log.notice = self._log.notice or f"{self._log.path}: {what}"

    def _watched(self) -> Iterator[str]:
        frames = 0
        for line in self._whole():
            self._number += 1
            text = line.strip()
            if not text:
                continue  # it would end python-can's header
            self.last = text
            is_frame = bool(self._frame.match(text))
            if is_frame and not frames and self._end_of_header:
                yield self._end_of_header
            frames += is_frame
            if not frames:
                self.header.append(text)
            self.answered = not is_frame
            yield text + "\n"
            if not self.answered:
                raise LogError(f"{self.place()}: not a frame as it should be: {text[:_SHOWN]!r}")

    def _whole(self) -> Iterator[str]:
        """Every line that has its end."""
        tail = b""
        for block in blocks(self._log):
            *whole, tail = (tail + block).split(b"\n")
            for line in whole:
                yield line.decode("utf-8", "replace")
        text = tail.decode("utf-8", "replace")
        if text.endswith("\r") or _ASC_END.fullmatch(text):
            yield text
        elif text.strip():
            self.note(
                f"line {self._number + 1}: the file ends within this line, which is not read: "
                f"{text[:_SHOWN].strip()!r}"
            )


class _LineFile:
    """What python-can's readers ask of a text file: lines, and to be closed."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines = lines

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> str:
        return next(self._lines)

    def close(self) -> None:
        """Nothing: the lines' own file closes at its end."""


def _chunks(lines: _Lines, reader: Iterable[Message]) -> Iterator[list[Message]]:
    messages = _answering(lines, reader)
    while True:
        with _refusing(lines.place):
            chunk = list(islice(messages, _CHUNK))
        if not chunk:
            return
        yield chunk


def _answering(lines: _Lines, reader: Iterable[Message]) -> Iterator[Message]:
    for message in reader:
        lines.answered = True
        yield message
