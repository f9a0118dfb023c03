"""BUSMASTER logs of CAN; several sessions appended to one file make a single log.

    ***START DATE AND TIME 20:11:2013 14:19:9:538***       headings; the last number is in ms
    14:19:11:4184 Tx 1 0x099 s 8 00 00 00 00 00 00 00 00   hours, minutes, seconds, decimals of one
    14:19:11:4192 Rx 2 0x18FEF100 x 8 00 00 …              x: an extended identifier
    14:19:11:4200 Rx 2 0x100 sr 8                          sr, xr: remote
    14:08:20:4009 Tx 1 0021 s 2 000 255                    after ***DEC***

Dates are in the time zone of this machine. More than 8 bytes mean CAN FD, which has no mark. A time
of day that falls by more than half a day is of the next day.

Source: BUSMASTER, `FormatMsgCAN.cpp`, `FormatMsgCommon.cpp`, `LogObjectCAN.cpp`.
"""

import re
from datetime import datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.logs import scan
from can_rig.logs.frames import (
    CLASSIC_BYTES,
    EXTENDED,
    FD,
    FD_BYTES,
    NS_PER_S,
    REMOTE,
    SENT,
    Format,
    Log,
    UInt8s,
)
from can_rig.logs.text import LAST_NS, TextReader, shown
from firmware_model.compiled import compiled

_NS_DIGITS = 9
_MOST_HOURS = 1 << 20
_DAY_NS: Final = 24 * 3600 * NS_PER_S
_LATE_NS: Final = 60 * NS_PER_S
"""So long after midnight a frame of the day before may come, from another bus."""
_STAR, _COLON, _ZERO = ord("*"), ord(":"), ord("0")
_R, _S, _T, _X = ord("r"), ord("s"), ord("t"), ord("x")
_START: Final = re.compile(
    rb"\*+START DATE AND TIME\s+(\d+):(\d+):(\d+)\s+(\d+):(\d+):(\d+):(\d+)\*+", re.I
)
_PROTOCOL: Final = re.compile(rb"\*+PROTOCOL\s+(.*?)\*+", re.I)
_MODE: Final = re.compile(rb"\*+(SYSTEM|ABSOLUTE|RELATIVE) MODE\*+", re.I)
_BASE: Final = re.compile(rb"\*+(HEX|DEC)\*+", re.I)


@compiled
def _line(text: UInt8s, at: int, bases: NDArray[np.int64], row: UInt8s) -> scan.Found:
    """See `scan.Line`; ``bases`` has the base of bytes and of identifiers without ``0x``."""
    at = scan.blanks(text, at)
    if text[at] == _STAR:
        return scan.HEADING, 0, 0, 0, 0, 0, at
    if text[at] == scan.NEWLINE:
        return scan.NO_FRAME, 0, 0, 0, 0, 0, at
    time_ns, at = _time(text, at)
    at = scan.next_word(text, at)
    if at < 0 or scan.word_end(text, at) != at + 2 or text[at + 1] | scan.LOWER != _X:
        return scan.BAD
    if text[at] | scan.LOWER not in (_R, _T):
        return scan.BAD
    bits = SENT * (text[at] | scan.LOWER == _T)
    bus, at = scan.number(text, scan.next_word(text, at + 2), scan.DECIMAL, 255)
    at = scan.next_word(text, at)
    base = int(bases[0])
    if at >= 0 and text[at] == _ZERO and text[at + 1] | scan.LOWER == _X:
        at += 2
        base = scan.HEXADECIMAL
    identifier, at = scan.number(text, at, base, scan.EXTENDED_ID)
    at = scan.next_word(text, at)
    if at < 0 or text[at] | scan.LOWER not in (_S, _X):
        return scan.BAD
    end = scan.word_end(text, at)
    bits |= EXTENDED * (text[at] | scan.LOWER == _X)
    if end == at + 2 and text[at + 1] | scan.LOWER == _R:
        bits |= REMOTE
    elif end != at + 1:
        return scan.BAD
    size, at = scan.number(text, scan.next_word(text, end), scan.DECIMAL, FD_BYTES)
    if bits & REMOTE:
        size = min(size, CLASSIC_BYTES)
    elif at >= 0:
        at = scan.payload(text, at, int(bases[0]), size, row)
        if at >= 0 and scan.next_word(text, at) >= 0:  # more bytes than announced
            return scan.BAD
    if at < 0:
        return scan.BAD
    return scan.FRAME, time_ns, identifier, bits | FD * (size > CLASSIC_BYTES), bus, size, at


@compiled
def _time(text: UInt8s, at: int) -> tuple[int, int]:
    """``hours:minutes:seconds:decimals`` in ns, and the position after it; -1: no time."""
    value = 0
    for most in (_MOST_HOURS, 59, 59):
        part, at = scan.number(text, at, scan.DECIMAL, most)
        if at < 0 or text[at] != _COLON:
            return 0, -1
        value = 60 * value + part
        at += 1
    first = at
    for _ in range(_NS_DIGITS):
        value *= scan.DECIMAL
        if scan.DIGIT[text[at]] < scan.DECIMAL:
            value += int(scan.DIGIT[text[at]])
            at += 1
    return value, at if at > first else -1


class _Reader(TextReader):
    parse = scan.line_loop(_line)

    def __init__(self, log: Log) -> None:
        super().__init__(log)
        self.settings = np.array([scan.HEXADECIMAL])
        self._start: datetime | None = None
        self._is_time_of_day = True
        self._midnights = 0  # since the start
        self._last_ns: int | None = None  # time of day of the last frame, or of the start

    def heading(self, line: bytes) -> None:
        """Protocol, date, what time stamps count from, and the base of numbers.

        Raises:
            LogError: the log has another protocol, or its time stamps cannot be added up.
        """
        if found := _PROTOCOL.match(line):
            if found[1].strip().upper() != b"CAN":
                raise LogError(
                    f"{self.place()}: a BUSMASTER log of {shown(found[1])}; it must be one of CAN"
                )
        elif found := _BASE.match(line):
            is_decimal = found[1].upper() == b"DEC"
            self.settings = np.array([scan.DECIMAL if is_decimal else scan.HEXADECIMAL])
        elif found := _MODE.match(line):
            if found[1].upper() == b"RELATIVE":
                raise LogError(
                    f"{self.place()}: each time stamp is the distance to the one before it, "
                    "without a sign (RELATIVE MODE); it must be recorded in another mode"
                )
            self._is_time_of_day = found[1].upper() == b"SYSTEM"
        elif found := _START.match(line):
            day, month, year, hour, minute, second, millisecond = map(int, found.groups())
            try:
                self._start = datetime(year, month, day, hour, minute, second, millisecond * 1000)
                start_ns = _since_1970_ns(self._start)
            except (ValueError, OverflowError, OSError):
                raise LogError(f"{self.place()}: not a date: {shown(line)}") from None
            self.log.start_ns = self.log.start_ns or start_ns
            self._midnights = 0
            self._last_ns = ((60 * hour + minute) * 60 + second) * NS_PER_S
        self.zero_ns = 0
        if self._start is not None:
            midnight = self._start.replace(hour=0, minute=0, second=0, microsecond=0)
            self.zero_ns = _since_1970_ns(midnight if self._is_time_of_day else self._start)

    def counted(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Times of day go on after midnight."""
        if not self._is_time_of_day:
            return time_ns
        before = time_ns[0] if self._last_ns is None else self._last_ns
        steps = np.diff(time_ns, prepend=before)
        turns = (steps < -_DAY_NS // 2).astype(np.int64) - (steps > _DAY_NS - _LATE_NS)
        days = np.clip(self._midnights + np.cumsum(turns), 0, LAST_NS // _DAY_NS - 1)
        self._midnights, self._last_ns = int(days[-1]), int(time_ns[-1])
        return time_ns + days * _DAY_NS

    def ignorable(self, line: bytes) -> bool:
        """A heading, which the session ends with."""
        return line.startswith(b"***")


def _since_1970_ns(date: datetime) -> int:
    since_ns = round(date.replace(microsecond=0).timestamp()) * NS_PER_S + date.microsecond * 1000
    if not 0 <= since_ns <= LAST_NS:
        raise OverflowError
    return since_ns


BUSMASTER: Final = Format(
    key="BUSMASTER", mark=re.compile(rb"\s*\*\*\*\s*[<\[A-Z]", re.I), read=_Reader.of
)
