"""Vector ASCII logs.

    1.000000 1  123             Rx   d 2 0A 0B  Length = 0 BitCount = 64 ID = 291
    1.400291 1  12345678x       Tx   r 4                      remote; x: an extended identifier
    1.500000 1  ErrorFrame
    2.000000 CANFD   1 Rx  5A1  Name  1 0 2 2 11 22  130000 130 3000 0 0 0 0 0
                               BRS ESI DLC length bytes, duration, bits, flags, …

The symbolic name is optional. Of the flags bit 4 marks a remote frame, and bit 12 is set in frames
of CAN FD only; without bit 12, a CAN FD controller received a classic frame. Anything else
(statistics, chip status, J1939 transport) is passed over. The date is in the time zone of this
machine. The file marks its own end, so truncation is noticed.

Source: Vector, "CAN ASCII Logging Files Format Specification".
"""

import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Final

import numpy as np
from can.io import ASCReader, ASCWriter
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.logs import scan
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
    Format,
    Frames,
    Log,
    UInt8s,
)
from can_rig.logs.text import TextReader
from firmware_model.compiled import compiled

_NS_DIGITS = 9
_DATA, _REMOTE, _X = 100, 114, 120
_CANFD = np.frombuffer(b"canfd", np.uint8)
_ERROR_FRAME = np.frombuffer(b"errorframe", np.uint8)
_FIRST_LINE = np.frombuffer(b"date ", np.uint8)
_TX, _RX = np.frombuffer(b"tx", np.uint8), np.frombuffer(b"rx", np.uint8)
_EDL_FLAG, _REMOTE_FLAG = 1 << 12, 1 << 4
_MOST = (1 << 32) - 1
_HEADER: Final = re.compile(r"date\s|base\s|//|begin\s+triggerblock|(no\s+)?internal\s", re.I)
_BASE: Final = re.compile(r"base\s+(hex|dec)(\s+timestamps\s+(absolute|relative))?", re.I)
_DATE: Final = re.compile(r"(?:date|begin\s+triggerblock)\s+\w+\s+(.+)", re.I)
_MOST_NS: Final = 1 << 62  # in the year 2116: int64 keeps room for time stamps
_BEGIN: Final = re.compile(r"begin\s+triggerblock", re.I)
_END: Final = re.compile(rb"\s*end\s+triggerblock\s*", re.I)


@compiled
def _line(text: UInt8s, at: int, bases: NDArray[np.int64], row: UInt8s) -> scan.Found:
    """See `scan.Line`; ``bases`` has the base of identifiers, DLCs and bytes."""
    base = int(bases[0])
    begin = at = scan.blanks(text, at)
    time_ns, at = scan.fixed_point(text, at, _NS_DIGITS)
    at = scan.next_word(text, at)
    if at < 0:
        second = scan.same_word(text, begin, _FIRST_LINE)
        return scan.HEADING if second else scan.NO_FRAME, 0, 0, 0, 0, 0, begin
    if scan.same_word(text, at, _CANFD):
        return _fd_frame(text, at + len(_CANFD), base, time_ns, row)
    end = scan.word_end(text, at)
    bus, after = scan.number(text, at, scan.DECIMAL, 256)
    name = scan.next_word(text, end)
    if name < 0 or scan.DIGIT[text[at]] >= scan.DECIMAL or (after >= 0 and after != end):
        return scan.NO_FRAME, 0, 0, 0, 0, 0, begin
    fits = after == end and bus > 0
    if scan.same_word(text, name, _ERROR_FRAME):
        return scan.FRAME if fits else scan.BAD_LINE, time_ns, 0, ERROR, bus - 1, 0, name
    at = scan.next_word(text, scan.word_end(text, name))
    direction = _direction(text, at)
    if direction < 0:
        return scan.NO_FRAME, 0, 0, 0, 0, 0, begin
    identifier, bits, end = _identifier(text, name, base)
    at = scan.next_word(text, at + 2)
    if not fits or end < 0 or at < 0:
        return scan.BAD
    bits |= direction
    kind = text[at] | scan.LOWER
    at = scan.next_word(text, scan.word_end(text, at))
    if kind == _REMOTE:
        size = scan.number(text, at, base, _MOST)[0] if at >= 0 else 0
        size = min(size, CLASSIC_BYTES)
        return scan.FRAME, time_ns, identifier, bits | REMOTE, bus - 1, size, end
    size, at = scan.number(text, at, base, len(scan.BYTES_OF_DLC) - 1)
    size = min(size, CLASSIC_BYTES)
    if kind != _DATA or at < 0:
        return scan.BAD
    at = scan.payload(text, at, base, size, row)
    return scan.FRAME if at >= 0 else scan.BAD_LINE, time_ns, identifier, bits, bus - 1, size, at


@compiled
def _fd_frame(text: UInt8s, at: int, base: int, time_ns: int, row: UInt8s) -> scan.Found:
    """The words after CANFD."""
    bus, at = scan.number(text, scan.next_word(text, at), scan.DECIMAL, 256)
    at = scan.next_word(text, at)
    direction = _direction(text, at)
    at = scan.next_word(text, at + 2) if direction >= 0 else -1
    if at < 0 or bus < 1:
        return scan.BAD
    if scan.same_word(text, at, _ERROR_FRAME):
        return scan.FRAME, time_ns, 0, ERROR | FD | direction, bus - 1, 0, at
    identifier, bits, end = _identifier(text, at, base)
    at = scan.next_word(text, end)
    if at >= 0 and scan.number(text, at, scan.DECIMAL, _MOST)[1] != scan.word_end(text, at):
        at = scan.next_word(text, scan.word_end(text, at))  # past the symbolic name
    switch, at = scan.number(text, at, scan.DECIMAL, 1)
    state, at = scan.number(text, scan.next_word(text, at), scan.DECIMAL, 1)
    dlc, at = scan.number(text, scan.next_word(text, at), base, len(scan.BYTES_OF_DLC) - 1)
    size, at = scan.number(text, scan.next_word(text, at), scan.DECIMAL, FD_BYTES)
    if end < 0 or at < 0:
        return scan.BAD
    at = scan.payload(text, at, base, size, row)
    if at < 0:
        return scan.BAD
    marks = _flags(text, at)
    bits |= direction
    if (marks >= 0 and marks & _REMOTE_FLAG) or (size == 0 and dlc > 0):
        asked = min(int(scan.BYTES_OF_DLC[dlc]), CLASSIC_BYTES)
        return scan.FRAME, time_ns, identifier, bits | REMOTE, bus - 1, asked, at
    if marks <= 0 or marks & _EDL_FLAG or size > CLASSIC_BYTES or switch or state:
        bits |= FD | BITRATE_SWITCH * switch | ERROR_STATE * state
    return scan.FRAME, time_ns, identifier, bits, bus - 1, size, at


@compiled
def _flags(text: UInt8s, at: int) -> int:
    """The third number after the payload, hexadecimal; -1: missing."""
    for _ in range(2):
        at = scan.next_word(text, at)
        if at < 0:
            return -1
        at = scan.word_end(text, at)
    found, end = scan.number(text, scan.next_word(text, at), scan.HEXADECIMAL, _MOST)
    return found if end >= 0 and text[end] <= scan.SPACE else -1


@compiled
def _direction(text: UInt8s, at: int) -> int:
    """SENT or 0 for the word Tx or Rx; -1: neither word."""
    if at < 0 or scan.word_end(text, at) != at + 2:
        return -1
    if scan.same_word(text, at, _TX):
        return SENT
    return 0 if scan.same_word(text, at, _RX) else -1


@compiled
def _identifier(text: UInt8s, at: int, base: int) -> tuple[int, int, int]:
    """``123`` or ``12345678x``: identifier, flags, and the position after it; -1: no identifier."""
    value, end = scan.number(text, at, base, scan.EXTENDED_ID)
    if end < 0:
        return 0, 0, -1
    bits = 0
    if text[end] | scan.LOWER == _X:
        bits = EXTENDED
        end += 1
    elif value > scan.STANDARD_ID:
        return 0, 0, -1
    return value, bits, end if end == scan.word_end(text, end) else -1


class _Reader(TextReader):
    parse = scan.line_loop(_line)
    first_frame = re.compile(
        rb"\s*\d+(\.\d*)?[ \t]+(\d+[ \t]+\S+[ \t]+(Tx|Rx)\b|\d+[ \t]+ErrorFrame|CANFD\s)", re.I
    )

    def __init__(self, log: Log) -> None:
        super().__init__(log)
        self.settings = np.array([scan.HEXADECIMAL])

    def begin(self) -> None:
        """The base of numbers, and the date.

        Raises:
            LogError: the reader does not support the kind of time stamps.
        """
        for line in self.header:
            found = _BASE.match(line)
            if found is None:
                continue
            is_decimal = found[1].lower() == "dec"
            self.settings = np.array([scan.DECIMAL if is_decimal else scan.HEXADECIMAL])
            if (found[3] or "").lower() == "relative":
                raise LogError(
                    f"{self.log.path}: each time stamp is relative to the one before it "
                    "('timestamps relative'); it must be exported with 'timestamps absolute'"
                )
        self.log.start_ns = self.zero_ns = _start_ns(self.header)

    def ignorable(self, line: bytes) -> bool:
        """Whether the line is the end mark."""
        return bool(_END.fullmatch(line))

    def finish(self) -> None:
        """Refuse a text without header and frame; note a missing end."""
        path = self.log.path
        if not self.frames and not any(_HEADER.match(line) for line in self.header):
            raise LogError(f"{path}: not a Vector ASCII log: it has neither a header nor a frame")
        if any(_BEGIN.match(line) for line in self.header) and not _END.fullmatch(self.last):
            self.log.notice = self.log.notice or (
                f"{path}: has no 'End TriggerBlock': its last frames are missing"
            )


def _start_ns(header: Sequence[str]) -> int:
    """Start of the recording [ns]: the last date; 0 without a date that python-can understands."""
    start_ns = 0
    for line in header:
        found = _DATE.match(line)
        if found is not None:
            try:
                start_ns = round(ASCReader._datetime_to_timestamp(found[1]) * 1e6) * 1000
            except (ValueError, OverflowError, OSError):
                start_ns = 0
    return start_ns if abs(start_ns) <= _MOST_NS else 0


class _Writer(ASCWriter):
    def _format_header_datetime(self, dt: datetime) -> str:
        """A date with three digits of milliseconds: python-can writes 7 ms as ``.7``."""
        return dt.strftime(f"%a %b %d %H:%M:%S.{dt.microsecond // 1000:03d} %Y")


def _write(chunks: Iterable[Frames], path: Path, start_ns: int, _final: Path) -> None:
    with _Writer(path) as writer:
        writer.log_event("Start of measurement", start_ns / NS_PER_S)
        writer.started = 0.0
        for frames in chunks:
            for message in frames.messages(start_ns):
                writer.on_message_received(message)


VECTOR_ASCII: Final = Format(
    key=".asc",
    mark=re.compile(
        rb"\s*(//[^\n]*\s*)*(date[ \t]+\w|base[ \t]+(hex|dec)|begin[ \t]+triggerblock)", re.I
    ),
    read=_Reader.of,
    write=_write,
    name="a Vector ASCII log",
    time_ns=1_000,
    start_ns=1_000_000,
    before_start=False,
    error_direction=False,
    error_content=False,
)
