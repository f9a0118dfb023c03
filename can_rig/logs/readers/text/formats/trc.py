"""PEAK traces, plain or gzipped; and, read alike, CARBUS Analyzer's traces and Microchip's logs.

    166064;RX;0x0000027A;7;0x30;0x30;0x0D;0x8C;0x09;0x15;0x00;     Microchip; time in ms

Microchip's CAN BUS Analyzer, and SavvyCAN like it, writes neither a bus nor a mark of remote
frames; an identifier of more than 11 bits is extended. Source: SavvyCAN, `framefileio.cpp`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from typing import Final

import numpy as np

from can_rig.errors import LogError
from can_rig.logs.frames import REMOTE, Frames, UInt8s
from can_rig.logs.log import Log
from can_rig.logs.readers.text.formats.trc_lines import parse
from can_rig.logs.readers.text.headed import HeadedReader

_COLUMNS: Final = {
    "1.0": "nOILD",
    "1.1": "NOTILD",
    "1.2": "NOBTILD",
    "1.3": "NOBTIRLD",
}
"""Columns by version; from 2.0 on the trace names its own."""

_CARBUS: Final = "@ TEXT @ "
_BLANKS: Final = bytes.maketrans(b";", b" ")
_WHOLE: Final = re.compile(rb";(0[xX][0-9A-Fa-f]{2})?\s*\Z")
_NEEDED: Final = frozenset("OTID")
_DAYS_TO_1970: Final = 25569
"""PEAK counts days from 30 December 1899."""
_US_PER_DAY: Final = 86_400_000_000
_MOST_DAYS: Final = 53_000  # in the year 2115


def read_trc(log: Log) -> Iterator[Frames]:
    """Chunks of a PEAK trace or of a CARBUS Analyzer trace; the latter has no date.

    Raises:
        LogError: neither kind of trace, or a line is not a frame.
    """
    reader = _Reader(log)
    yield from reader.started()
    if not reader.frames and not any(line.startswith((";", _CARBUS)) for line in reader.header):
        raise LogError(f"{log.path}: not a PEAK trace: it has neither a header nor a frame")


def read_microchip(log: Log) -> Iterator[Frames]:
    """Chunks of a Microchip log, whose time stamps are on a clock of its own.

    Raises:
        LogError: a line is not a frame.
    """
    yield from _MicrochipReader(log).started()


class _Reader(HeadedReader):
    """Lines with columns named by letters; see `parse`."""

    first_bus = 1
    first_frame = re.compile(rb"[ \t]*\d+(\)?[ \t]|,\d+\t)")

    def __init__(self, log: Log) -> None:
        super().__init__(log, self._parsed)
        self._columns: UInt8s = np.zeros(0, np.uint8)

    def blocks(self) -> Iterator[bytes]:
        """With newlines where CARBUS Analyzer has carriage returns."""
        is_carbus: bool | None = None
        for block in super().blocks():
            if is_carbus is None:
                is_carbus = block.startswith(_CARBUS.encode())
            yield block.replace(b"\r", b"\n") if is_carbus else block

    def ended(self, line: bytes, frame: Frames) -> bool:
        """A remote frame has no bytes, and a length of one digit."""
        return bool(frame.flags[-1] & REMOTE) or super().ended(line, frame)

    def begin(self) -> None:
        """Columns and start.

        Raises:
            LogError: the header lacks the columns, or the start is no date.
        """
        if self.header and self.header[0].startswith(_CARBUS):
            self.first_bus = 0
            self.use("sBFilD" if self.header[0].split()[3] == "2" else "SBFilD")
            self.has_own_clock = True
            return
        said = dict(line[2:].partition("=")[::2] for line in self.header if line.startswith(";$"))
        version = said.get("FILEVERSION", "1.0").strip()
        columns = said.get("COLUMNS", "").replace(",", "").strip() or _COLUMNS.get(version, "")
        if version not in _COLUMNS and not (set(columns) >= _NEEDED and set("lL") & set(columns)):
            raise LogError(
                f"{self.log.path}: a PEAK trace of version {version[:8]!r} with the columns "
                f"{columns[:20]!r}; it must be of version 1.0 to 1.3, or name its columns O, T, I, "
                "l or L, and D after $COLUMNS"
            )
        self.use(columns)
        self.log.start_ns = self._start_ns(said.get("STARTTIME", str(_DAYS_TO_1970)))

    def use(self, columns: str) -> None:
        """Set the columns named by the letters."""
        self._columns = np.frombuffer(columns.encode("ascii", "replace"), np.uint8)

    def _start_ns(self, days: str) -> int:
        try:
            since = Decimal(days.strip()) - _DAYS_TO_1970
            if abs(since) < _MOST_DAYS:
                return round(since * _US_PER_DAY) * 1000
        except InvalidOperation:
            pass
        raise LogError(
            f"{self.log.path}: $STARTTIME={days[:40]} must be days since 30 December 1899, "
            f"less than {_MOST_DAYS + _DAYS_TO_1970}"
        )

    def _parsed(self, text: UInt8s, at: int, room: Frames) -> tuple[int, int, int, int]:
        return parse(
            text,
            at,
            self._columns,
            room.time_ns,
            room.arbitration_id,
            room.flags,
            room.channel,
            room.length,
            room.data,
        )


class _MicrochipReader(_Reader):
    first_frame = re.compile(rb"[ \t]*\d")
    has_own_clock = True

    def begin(self) -> None:
        """The same columns in every file."""
        self.use("OTilD")

    def ended(self, line: bytes, frame: Frames) -> bool:
        """A byte with both digits, or the text behind a byte."""
        return bool(_WHOLE.search(line))

    def _whole_lines(self, text: bytes) -> Iterator[Frames]:
        """The lines in a trace's form: parted by blanks, hexadecimal without a mark."""
        plain = text.translate(_BLANKS).replace(b"0x", b"").replace(b"0X", b"")
        yield from super()._whole_lines(plain)
