"""Vector ASCII logs, plain or gzipped."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final

from can.io import ASCReader

from can_rig.errors import LogError
from can_rig.logs.frames import Frames, UInt8s
from can_rig.logs.log import Log
from can_rig.logs.readers.text.formats.asc_lines import parse
from can_rig.logs.readers.text.headed import HeadedReader
from can_rig.logs.readers.text.scanning import DECIMAL, HEXADECIMAL

_HEADER: Final = re.compile(r"date\s|base\s|//|begin\s+triggerblock|(no\s+)?internal\s", re.I)
_BASE: Final = re.compile(r"base\s+(hex|dec)(\s+timestamps\s+(absolute|relative))?", re.I)
_DATE: Final = re.compile(r"(?:date|begin\s+triggerblock)\s+\w+\s+(.+)", re.I)
_MOST_NS: Final = 1 << 62  # in the year 2116: int64 keeps room for time stamps
_BEGIN: Final = re.compile(r"begin\s+triggerblock", re.I)
_END: Final = re.compile(rb"\s*end\s+triggerblock\s*", re.I)


def read_asc(log: Log) -> Iterator[Frames]:
    """Chunks of a Vector ASCII log; its date is in the time zone of this machine.

    The file marks its own end, so truncation is noticed.

    Raises:
        LogError: not a Vector ASCII log, or a line is not a frame.
    """
    reader = _Reader(log)
    yield from reader.started()
    if not reader.frames and not any(_HEADER.match(line) for line in reader.header):
        raise LogError(f"{log.path}: not a Vector ASCII log: it has neither a header nor a frame")
    if any(_BEGIN.match(line) for line in reader.header) and not _END.fullmatch(reader.last):
        log.notice = log.notice or (
            f"{log.path}: has no 'End TriggerBlock': its last frames are missing"
        )


class _Reader(HeadedReader):
    first_frame = re.compile(
        rb"\s*\d+(\.\d*)?[ \t]+(\d+[ \t]+\S+[ \t]+(Tx|Rx)\b|\d+[ \t]+ErrorFrame|CANFD\s)", re.I
    )

    def __init__(self, log: Log) -> None:
        super().__init__(log, self._parsed)
        self._base = HEXADECIMAL

    def begin(self) -> None:
        """The base of numbers, and the date.

        Raises:
            LogError: the reader does not support the kind of time stamps.
        """
        for line in self.header:
            found = _BASE.match(line)
            if found is None:
                continue
            self._base = DECIMAL if found[1].lower() == "dec" else HEXADECIMAL
            if (found[3] or "").lower() == "relative":
                raise LogError(
                    f"{self.log.path}: each time stamp is relative to the one before it "
                    "('timestamps relative'); it must be exported with 'timestamps absolute'"
                )
        self.log.start_ns = _start_ns(self.header)

    def ignorable(self, line: bytes) -> bool:
        """Whether the line is the end mark."""
        return bool(_END.fullmatch(line))

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
