"""candump logs.

    (1436509052.249713) vcan2 123#1122334455667788 R    a frame, received; T: sent; or neither
    (1436509052.249714) vcan2 12345678#                 eight digits: an extended identifier
    (1436509052.249715) vcan2 123##1112233              FD, then its flags: 1 BRS, 2 ESI
    (1436509052.249716) vcan2 123#R8                    a remote frame that asks for 8 bytes
    (1436509052.249717) vcan2 20000080#0000000000000000 bit 29: an error frame, its classes
    (1436509052.249718) vcan2 123#1122334455667788_9    a raw DLC above 8; the payload stays 8 bytes
    # not of candump                                    a comment, which canplayer passes over, too

Source: can-utils, `lib.h` (parse_canframe, sprint_canframe) and `candump.c`.
"""

import gzip
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
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
    MAX_BUSES,
    REMOTE,
    SENT,
    Format,
    Frames,
    UInt8s,
)
from can_rig.logs.text import TextReader, word
from firmware_model.compiled import compiled

_ERROR_BIT, _REMOTE_BIT = 1 << 29, 1 << 30
_NS_DIGITS = 9
_HASH, _UNDERSCORE, _OPEN, _CLOSE = 35, 95, 40, 41
_R, _T = 114, 116
_DIRECTION: Final = re.compile(rb"[ \t][RrTt][ \t\r]*$")  # at the end of the line
_FD_FLAGS_SHIFT: Final = 4  # of BITRATE_SWITCH and ERROR_STATE, in candump's order


@compiled
def _line(text: UInt8s, at: int, names: NDArray[np.int64], row: UInt8s) -> scan.Found:
    """See `scan.Line`; ``names`` are those of the known buses, each with a newline after it."""
    at = scan.blanks(text, at)
    if text[at] in (scan.NEWLINE, _HASH):
        return scan.NO_FRAME, 0, 0, 0, 0, 0, at
    if text[at] != _OPEN:
        return scan.BAD
    time_ns, at = scan.fixed_point(text, at + 1, _NS_DIGITS)
    if at < 0 or text[at] != _CLOSE:
        return scan.BAD
    name = scan.next_word(text, at + 1)
    if name < 0:
        return scan.BAD
    end = scan.word_end(text, name)
    bits, identifier, at = _identifier(text, scan.blanks(text, end))
    if at < 0 or not scan.is_blank(text[end]):
        return scan.BAD
    bits, size, at = _payload(text, at, bits, row)
    if at < 0:
        return scan.BAD
    if scan.is_blank(text[at]):
        at = scan.blanks(text, at)
        if text[at] | scan.LOWER == _T:
            bits |= SENT
            at = scan.blanks(text, at + 1)
        elif text[at] | scan.LOWER == _R:
            at = scan.blanks(text, at + 1)
    if text[at] != scan.NEWLINE:
        return scan.BAD
    return scan.FRAME, time_ns, identifier, bits, _bus(text, name, end, names), size, at


@compiled
def _bus(text: UInt8s, begin: int, end: int, names: NDArray[np.int64]) -> int:
    """Index of ``text[begin:end]`` among the names; -1: no match."""
    index = at = 0
    while at < len(names):
        place = begin
        while place < end and text[place] == names[at]:
            place += 1
            at += 1
        if place == end and names[at] == scan.NEWLINE:
            return index
        at = scan.next_line(names, at)
        index += 1
    return -1


@compiled
def _identifier(text: UInt8s, at: int) -> tuple[int, int, int]:
    """``123#`` or ``12345678#``: flags, identifier, position after it; -1: no identifier."""
    first = at
    value = 0
    while scan.DIGIT[text[at]] != scan.NOT_A_DIGIT and at - first < 9:
        value = value << 4 | int(scan.DIGIT[text[at]])
        at += 1
    digits = at - first
    if text[at] != _HASH or not 0 < digits <= 8 or (digits <= 3 and value > scan.STANDARD_ID):
        return 0, 0, -1
    bits = 0
    if value & _ERROR_BIT:
        bits = ERROR
    elif digits > 3:
        bits = EXTENDED
    if value & _REMOTE_BIT:
        bits |= REMOTE
    return bits, value & scan.EXTENDED_ID, at + 1


@compiled
def _payload(text: UInt8s, at: int, bits: int, row: UInt8s) -> tuple[int, int, int]:
    """The text after the first ``#``, into ``row``: flags, length, and the position after it.

    The position is -1 for text that is no payload.
    """
    max_bytes = CLASSIC_BYTES
    if text[at] == _HASH:
        kind = scan.DIGIT[text[at + 1]]
        if kind == scan.NOT_A_DIGIT:
            return 0, 0, -1
        max_bytes = FD_BYTES
        bits |= FD | BITRATE_SWITCH * (int(kind) & 1) | ERROR_STATE * (int(kind) >> 1 & 1)
        at += 2
    elif text[at] | scan.LOWER == _R:
        bits |= REMOTE
        at += 1
        size = 0
        if scan.DIGIT[text[at]] != scan.NOT_A_DIGIT:
            size = int(scan.DIGIT[text[at]])
            at += 1
        if size > CLASSIC_BYTES:
            return 0, 0, -1
        return bits, size, _raw_dlc(text, at, size)
    size = 0
    while scan.DIGIT[text[at]] != scan.NOT_A_DIGIT:
        low = scan.DIGIT[text[at + 1]]
        if low == scan.NOT_A_DIGIT or size == max_bytes:
            return 0, 0, -1
        if size < len(row):
            row[size] = scan.DIGIT[text[at]] << 4 | low
        size += 1
        at += 2
    return bits, size, _raw_dlc(text, at, size) if max_bytes == CLASSIC_BYTES else at


@compiled
def _raw_dlc(text: UInt8s, at: int, size: int) -> int:
    """The position after ``_9`` to ``_F``, which only a frame of 8 bytes may have; -1: refused."""
    if text[at] != _UNDERSCORE:
        return at
    dlc = scan.DIGIT[text[at + 1]]
    return at + 2 if size == CLASSIC_BYTES and CLASSIC_BYTES < dlc != scan.NOT_A_DIGIT else -1


class _Reader(TextReader):
    parse = scan.line_loop(_line)
    wanted = "a frame as candump -L writes it"
    has_date = False
    _names: tuple[bytes, ...] = ()

    def ended(self, line: bytes, frame: Frames) -> bool:
        """A direction or, where the line before has none, as many bytes as a frame can have."""
        if _DIRECTION.search(line) or _DIRECTION.search(self.before):
            return bool(_DIRECTION.search(line))
        return int(frame.length[-1]) == (FD_BYTES if frame.flags[-1] & FD else CLASSIC_BYTES)

    def ignorable(self, line: bytes) -> bool:
        """A comment."""
        return line.lstrip().startswith(b"#")

    def add_bus(self, line: bytes) -> None:
        """The second word of the line.

        Raises:
            LogError: too many buses.
        """
        if len(self._names) == MAX_BUSES:
            raise LogError(
                f"{self.place()}: bus number {MAX_BUSES + 1}; "
                f"there must be at most {MAX_BUSES} buses in a log"
            )
        self._names += (line.split()[1],)
        self.settings = np.array([*b"".join(name + b"\n" for name in self._names)], np.int64)

    def bus_names(self) -> tuple[str, ...]:
        """In the order of first appearance."""
        return tuple(map(word, self._names))


def _write(chunks: Iterable[Frames], path: Path, _start_ns: int, _final: Path) -> None:
    """Write a log; gzipped, without a date of its own, if the name ends in ``.gz``."""
    compressed = path.suffix.lower() == ".gz"
    with gzip.GzipFile(path, "wb", mtime=0) if compressed else path.open("wb") as file:
        for frames in chunks:
            file.write("".join(candump_lines(frames)).encode("ascii"))


def candump_lines(frames: Frames) -> Iterator[str]:
    """The line of each frame as ``candump -L`` writes it, followed by R or T."""
    text = frames.data.tobytes().hex().upper()
    width = 2 * frames.data.shape[1]
    for row, (time_ns, identifier, flags, channel, length) in enumerate(frames.rows()):
        time_us = (time_ns + 500) // 1000
        if flags & ERROR:
            head = f"{identifier | _ERROR_BIT:08X}#"
        else:
            head = f"{identifier:08X}#" if flags & EXTENDED else f"{identifier:03X}#"
        payload = text[row * width : row * width + 2 * length]
        if flags & REMOTE:
            payload = f"R{length:X}" if length else "R"
        elif flags & FD:
            payload = f"#{flags >> _FD_FLAGS_SHIFT & 3:X}{payload}"
        yield (
            f"({time_us // 1_000_000:010d}.{time_us % 1_000_000:06d}) {frames.channels[channel]} "
            f"{head}{payload} {'T' if flags & SENT else 'R'}\n"
        )


CANDUMP: Final = Format(
    key=".log",
    mark=re.compile(rb"(\s*#[^\n]*\n)*\s*\(\d+(\.\d*)?\)[ \t]+\S+[ \t]+[0-9A-Fa-f]+#"),
    read=_Reader.of,
    write=_write,
    name="a candump log",
    time_ns=1_000,
    bus_names=True,
)
