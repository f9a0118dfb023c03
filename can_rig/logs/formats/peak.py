"""PEAK traces; and, read alike, CARBUS Analyzer's traces and Microchip's logs.

    1)     1059  0300  7  00 00 00 00 04 00 00             version 1.0: N O I L D
    1)   1059.9  Rx   0300  7  00 00 00 00 04 00 00        version 1.1: N O T I L D
    1)  17535.400 1  Tx  00000100 -  8  00 …               version 1.3: N O B T I R L D
    1   17535.400 DT 1  00000100 Tx -  8  00 …             version 2.1: as $COLUMNS says
    2   17540.000 FB 1      0123 Rx -  9  00 …             CAN FD; L: DLC 9 is 12 bytes

A column is named by a letter: N number, O offset in ms, T type, B bus, I identifier (extended where
it has more than four digits), d direction, R reserved, l bytes, L data length code, D data. Types
that are no frames (ST, EC, Warng, …) are passed over.

    46,016 1  0004  45A  8  5A 04 00 …                     CARBUS Analyzer 2: s B F i l D
    15,321000 1  00000005  1B000067  8  67 00 …            CARBUS Analyzer 3: S B F i l D

Its columns are parted by tabs; where no data follow a length, the frame is a remote one. Letters: s
and S are seconds and a number of ms or µs, F flags, of which the lowest marks an extended
identifier, i an identifier that is extended if it has more than 11 bits. With i, more than 8 bytes
mean CAN FD.

    166064;RX;0x0000027A;7;0x30;0x30;0x0D;0x8C;0x09;0x15;0x00;     Microchip; time in ms

Microchip's CAN BUS Analyzer, and SavvyCAN like it, writes neither a bus nor a mark of remote
frames.

Traces of version 2.1 are written, without error frames.

Source: PEAK-System, "PEAK CAN TRC File Format"; SavvyCAN, `framefileio.cpp`.
"""

import re
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Final

import numpy as np
from can.util import channel2int
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
    UInt8s,
)
from can_rig.logs.text import TextReader
from firmware_model.compiled import compiled

_NS_DIGITS_OF_MS = 6
_NO_ID = (1 << 32) - 1
_STANDARD_DIGITS = 4
_CLOSE, _CAPITAL, _T_OF_TX = 41, 0xDF, ord("t")
_O, _T, _B, _I, _D = ord("O"), ord("T"), ord("B"), ord("I"), ord("D")
_DIRECTION, _BYTES, _DLC = ord("d"), ord("l"), ord("L")
_SECONDS_MS, _SECONDS_US, _FLAGS, _UNMARKED = ord("s"), ord("S"), ord("F"), ord("i")
_NS_PER_MS, _NS_PER_US = 1_000_000, 1_000
_MOST_SECONDS = 1 << 32
_COMMA = ord(",")
_UNTYPED = ord("n")  # the number in version 1.0, without types
_RTR = np.frombuffer(b"rtr", np.uint8)
_OTHER = -1

_FD_TYPES: Final = {
    0: "DT",
    FD: "FD",
    FD | BITRATE_SWITCH: "FB",
    FD | ERROR_STATE: "FE",
    FD | BITRATE_SWITCH | ERROR_STATE: "BI",
}
_TYPES = {name: bits for bits, name in _FD_TYPES.items()} | {"RR": REMOTE, "RX": 0, "TX": SENT}
_NAMES = np.array([ord(name[0]) << 8 | ord(name[1]) for name in _TYPES], np.int64)
_BITS = np.array(list(_TYPES.values()), np.int64)
_COLUMNS: Final = {"1.0": "nOILD", "1.1": "NOTILD", "1.2": "NOBTILD", "1.3": "NOBTIRLD"}
"""Columns by version; from 2.0 on the trace names its own."""

_CARBUS: Final = "@ TEXT @ "
_BLANKS: Final = bytes.maketrans(b";", b" ")
_WHOLE: Final = re.compile(rb";(0[xX][0-9A-Fa-f]{2})?\s*\Z")
_NEEDED: Final = frozenset("OTID")
_DAYS_TO_1970: Final = 25569
"""PEAK counts days from 30 December 1899."""
_US_PER_DAY: Final = 86_400_000_000
_MOST_DAYS: Final = 53_000  # in the year 2115
_NS_PER_DAY: Final = 1000 * _US_PER_DAY
_FIRST_LINE = np.frombuffer(b";$fileversion", np.uint8)


@compiled
def _line(text: UInt8s, at: int, columns: NDArray[np.int64], row: UInt8s) -> scan.Found:
    """See `scan.Line`; ``columns`` are the letters of the trace's own columns."""
    begin = at = scan.blanks(text, at)
    bits = _OTHER  # until the type is known
    time_ns = identifier = size = direction = 0
    bus = 1
    is_dlc = bad = is_unmarked = False
    if scan.DIGIT[text[at]] >= scan.DECIMAL:
        second = scan.same_word(text, begin, _FIRST_LINE)
        return scan.HEADING if second else scan.NO_FRAME, 0, 0, 0, 0, 0, begin
    for place in range(len(columns)):
        column = columns[place]
        if column == _D:
            break
        if place:
            at = scan.next_word(text, at)
        if at < 0:
            return scan.NO_FRAME if bits == _OTHER else scan.BAD_LINE, 0, 0, 0, 0, 0, begin
        after = end = scan.word_end(text, at)
        if column == _O:
            time_ns, after = scan.fixed_point(text, at, _NS_DIGITS_OF_MS)
        elif column in (_SECONDS_MS, _SECONDS_US):
            time_ns, after = _seconds(text, at, _NS_PER_MS if column == _SECONDS_MS else _NS_PER_US)
        elif column == _UNTYPED:
            bits = 0 if text[end - 1] == _CLOSE else _OTHER
        elif column == _T:
            bits = _type(text, at, end)
        elif column == _B:
            bus, after = scan.number(text, at, scan.DECIMAL, 255)
        elif column in (_I, _UNMARKED):
            identifier, after = scan.number(text, at, scan.HEXADECIMAL, _NO_ID)
            is_unmarked = column == _UNMARKED
            is_long = identifier > scan.STANDARD_ID if is_unmarked else end - at > _STANDARD_DIGITS
            direction |= EXTENDED * is_long
        elif column == _FLAGS:
            marks, after = scan.number(text, at, scan.HEXADECIMAL, _NO_ID)
            bits, direction = 0, EXTENDED * (marks & 1)
        elif column == _DIRECTION:
            direction |= SENT * (text[at] | scan.LOWER == _T_OF_TX)
        elif column in (_BYTES, _DLC):
            size, after = scan.number(text, at, scan.DECIMAL, FD_BYTES)
            is_dlc = column == _DLC
        bad |= after != end
        at = end
    if bits == _OTHER or identifier == _NO_ID:  # in version 1.0: bus state
        return scan.NO_FRAME, 0, 0, 0, 0, 0, begin
    if is_dlc:
        bad |= size >= len(scan.BYTES_OF_DLC)
        size = int(scan.BYTES_OF_DLC[min(size, len(scan.BYTES_OF_DLC) - 1)])
    bits |= FD * (is_unmarked and size > CLASSIC_BYTES)
    if not bits & FD:
        bad |= not is_dlc and size > CLASSIC_BYTES
        size = min(size, CLASSIC_BYTES)
    bits |= direction
    if bad:
        return scan.BAD
    first = scan.next_word(text, at)
    if (size and _is_empty(text, at)) or (first >= 0 and scan.same_word(text, first, _RTR)):
        bits |= REMOTE
    if not bits & REMOTE:
        at = scan.payload(text, at, scan.HEXADECIMAL, size, row)
    return scan.FRAME if at >= 0 else scan.BAD_LINE, time_ns, identifier, bits, bus, size, at


@compiled
def _seconds(text: UInt8s, at: int, unit: int) -> tuple[int, int]:
    """``seconds,parts`` in ns and the position after it; the fraction may lack leading zeros."""
    seconds, at = scan.number(text, at, scan.DECIMAL, _MOST_SECONDS)
    if at < 0 or text[at] != _COMMA:
        return 0, -1
    parts, at = scan.number(text, at + 1, scan.DECIMAL, NS_PER_S // unit - 1)
    return seconds * NS_PER_S + parts * unit, at


@compiled
def _is_empty(text: UInt8s, at: int) -> bool:
    """Whether two tabs enclose only spaces."""
    if text[at] != scan.TAB:
        return False
    at += 1
    while text[at] == scan.SPACE:
        at += 1
    return bool(text[at] == scan.TAB)


@compiled
def _type(text: UInt8s, at: int, end: int) -> int:
    """The flags of a type; _OTHER for types without a frame."""
    if end == at + 2:
        name = int(text[at] & _CAPITAL) << 8 | int(text[at + 1] & _CAPITAL)
        for known in range(len(_NAMES)):
            if name == _NAMES[known]:
                return int(_BITS[known])
    return _OTHER


class _Reader(TextReader):
    """Lines with columns named by letters; CARBUS Analyzer's have no date."""

    parse = scan.line_loop(_line)
    first_bus = 1
    first_frame = re.compile(rb"[ \t]*\d+(\)?[ \t]|,\d+\t)")

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
            self.has_date = False
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
        self.log.start_ns = self.zero_ns = self._start_ns(said.get("STARTTIME", str(_DAYS_TO_1970)))

    def use(self, columns: str) -> None:
        """Set the columns named by the letters."""
        self.settings = np.array([*columns.encode("ascii", "replace")], np.int64)

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

    def finish(self) -> None:
        """Refuse a text without header and frame."""
        if not self.frames and not any(line.startswith((";", _CARBUS)) for line in self.header):
            raise LogError(
                f"{self.log.path}: not a PEAK trace: it has neither a header nor a frame"
            )


class _MicrochipReader(_Reader):
    first_frame = re.compile(rb"[ \t]*\d")
    has_date = False

    def begin(self) -> None:
        """The same columns in every file."""
        self.use("OTilD")

    def ended(self, line: bytes, frame: Frames) -> bool:
        """A byte with both digits, or the text after a byte."""
        return bool(_WHOLE.search(line))

    def plain(self, text: bytes) -> bytes:
        """The lines in a trace's form: parted by blanks, hexadecimal without a mark."""
        return text.translate(_BLANKS).replace(b"0x", b"").replace(b"0X", b"")

    def finish(self) -> None:
        """A log may be empty."""


def _write(chunks: Iterable[Frames], path: Path, start_ns: int, final: Path) -> None:
    """Write a PEAK trace; its header names the file ``final``."""
    with path.open("w", encoding="utf-8", newline="\r\n") as file:
        file.write(_header(start_ns, final))
        number = 0
        for frames in chunks:
            file.write("".join(_lines(frames, start_ns, number)))
            number += len(frames)


def _header(start_ns: int, final: Path) -> str:
    days = _DAYS_TO_1970 + Decimal(start_ns) / _NS_PER_DAY
    start = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=start_ns // 1000)
    return (
        f";$FILEVERSION=2.1\n;$STARTTIME={days:.13f}\n;$COLUMNS=N,O,T,B,I,d,R,l,D\n;\n"
        f";   {final.absolute()}\n;   Start time: {start:%d.%m.%Y %H:%M:%S.%f}\n"
        ";-------------------------------------------------------------------------------\n"
        ";   Message   Time    Type    ID     Rx/Tx\n"
        ";   Number    Offset  |  Bus  [hex]  |  Reserved\n"
        ";   |         [ms]    |  |    |      |  |  Data Length\n"
        ";   |         |       |  |    |      |  |  |    Data [hex] ...\n"
        ";---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --\n"
    )


def _lines(frames: Frames, start_ns: int, before: int) -> Iterator[str]:
    # PEAK counts buses from 1.
    buses = [(channel2int(name) or 0) + 1 for name in frames.channels]
    rows = zip(frames.rows(), frames.data, strict=True)
    for count, (row, data) in enumerate(rows, before + 1):
        time_ns, identifier, flags, channel, length = row
        since_us = (time_ns - start_ns + 500) // 1000
        kind = "RR" if flags & REMOTE else _FD_TYPES[flags & (FD | BITRATE_SWITCH | ERROR_STATE)]
        payload = "" if flags & REMOTE else data[:length].tobytes().hex(" ").upper()
        name = f"{identifier:08X}" if flags & EXTENDED else f"{identifier:04X}"
        yield (
            f"{count:>7} {since_us // 1000:>9}.{since_us % 1000:03d} {kind} {buses[channel]:>2} "
            f"{name:>8} {'Tx' if flags & SENT else 'Rx'} -  {length:<4} {payload}\n"
        )


PEAK: Final = Format(
    key=".trc",
    mark=re.compile(rb"@ TEXT @ |\s*;(\$FILEVERSION|#{8})|(\s*;[^\n]*\n)*\s*1\)[ \t]+\d"),
    read=_Reader.of,
    write=_write,
    name="a PEAK trace",
    time_ns=1_000,
    start_ns=1_000,
    before_start=False,
    lacks=ERROR,
)
MICROCHIP: Final = Format(
    key="Microchip",
    mark=re.compile(rb"\s*//-+\s*Microchip |\s*\d+;[RT]X;0x", re.I),
    read=_MicrochipReader.of,
)
