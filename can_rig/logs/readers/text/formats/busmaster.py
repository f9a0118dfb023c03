"""BUSMASTER logs of CAN, plain or gzipped."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from typing import Final

from can_rig.errors import LogError
from can_rig.logs.frames import NS_PER_S, Frames, UInt8s
from can_rig.logs.log import Log
from can_rig.logs.readers.numbering import numbered
from can_rig.logs.readers.text.formats.busmaster_lines import parse
from can_rig.logs.readers.text.headed import LAST_NS, HeadedReader
from can_rig.logs.readers.text.lines import shown
from can_rig.logs.readers.text.scanning import DECIMAL, HEXADECIMAL

_START: Final = re.compile(
    rb"\*+START DATE AND TIME\s+(\d+):(\d+):(\d+)\s+(\d+):(\d+):(\d+):(\d+)\*+", re.I
)
_PROTOCOL: Final = re.compile(rb"\*+PROTOCOL\s+(.*?)\*+", re.I)
_MODE: Final = re.compile(rb"\*+(SYSTEM|ABSOLUTE|RELATIVE) MODE\*+", re.I)
_BASE: Final = re.compile(rb"\*+(HEX|DEC)\*+", re.I)


def read_busmaster(log: Log) -> Iterator[Frames]:
    """Chunks of a BUSMASTER log; its date is in the time zone of this machine.

    Several sessions appended to one file make a single log, which begins with the first session.

    Raises:
        LogError: not a BUSMASTER log, or a line is not a frame.
    """
    yield from _Reader(log).sessions()


class _Reader(HeadedReader):
    first_frame = None  # lines with *** are headings at any place

    def __init__(self, log: Log) -> None:
        super().__init__(log, self._parsed)
        self._base = HEXADECIMAL
        self._start: datetime | None = None
        self._is_time_of_day = True
        self._zero_ns = 0  # of the time stamps

    def sessions(self) -> Iterator[Frames]:
        """The chunks, on one clock.

        Raises:
            LogError: as `read_busmaster`.
        """
        for frames in self.read():
            if int(frames.time_ns.max()) > LAST_NS - self._zero_ns:
                raise LogError(f"{self.place()}: the time stamps must be before the year 2262")
            yield numbered(replace(frames, time_ns=frames.time_ns + self._zero_ns))

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
            self._base = DECIMAL if found[1].upper() == b"DEC" else HEXADECIMAL
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
        self._zero_ns = 0
        if self._start is not None:
            midnight = self._start.replace(hour=0, minute=0, second=0, microsecond=0)
            self._zero_ns = _since_1970_ns(midnight if self._is_time_of_day else self._start)

    def ignorable(self, line: bytes) -> bool:
        """A heading, which the session ends with."""
        return line.startswith(b"***")

    def _parsed(self, text: UInt8s, at: int, room: Frames) -> tuple[int, int, int, int]:
        return parse(
            text,
            at,
            self._base,
            room.time_ns,
            room.arbitration_id,
            room.flags,
            room.channel,
            room.length,
            room.data,
        )


def _since_1970_ns(date: datetime) -> int:
    since_ns = round(date.replace(microsecond=0).timestamp()) * NS_PER_S + date.microsecond * 1000
    if not 0 <= since_ns <= LAST_NS:
        raise OverflowError
    return since_ns
