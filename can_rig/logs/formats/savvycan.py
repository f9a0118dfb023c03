"""SavvyCAN's own CSV logs (GVRET).

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    39747828,000005EB,false,Rx,0,8,E8,45,85,4B,4A,28,36,69,       time in µs
    166064000,0000027A,false,0,3,30,30,0D,00,00,00,00,00,         without Dir, as of old

An identifier above 7FF is extended whatever the line says, as in SavvyCAN: some recorders write a
wrong mark. Neither CAN FD nor remote frames have a mark; more than 8 bytes mean CAN FD. Time stamps
come from the recorder's clock, without a date; classic data frames alone are written.

Source: SavvyCAN, `framefileio.cpp` (loadNativeCSVFile, saveNativeCSVFile).
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from can.util import channel2int
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.logs import scan
from can_rig.logs.frames import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FD,
    FD_BYTES,
    REMOTE,
    SENT,
    Format,
    Frames,
    UInt8s,
)
from can_rig.logs.text import TextReader, shown
from firmware_model.compiled import compiled

_NS_DIGITS_OF_US = 3
_COMMA, _R, _T = ord(","), ord("r"), ord("t")
_TRUE, _FALSE = np.frombuffer(b"true", np.uint8), np.frombuffer(b"false", np.uint8)
_COLUMNS: Final = re.compile(r"\W*time stamp,id,extended,(dir,)?bus,len(,d\d+)*,?", re.I)
_WHOLE: Final = re.compile(rb",([0-9A-Fa-f]{2})?\s*\Z")
_HEADER: Final = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"


@compiled
def _line(text: UInt8s, at: int, has_direction: NDArray[np.int64], row: UInt8s) -> scan.Found:
    """See `scan.Line`; ``has_direction`` has a value if the lines have the cell Dir."""
    at = scan.blanks(text, at)
    if text[at] == scan.NEWLINE:
        return scan.NO_FRAME, 0, 0, 0, 0, 0, at
    time_ns, at = scan.fixed_point(text, at, _NS_DIGITS_OF_US)
    identifier, at = scan.number(text, _next_cell(text, at), scan.HEXADECIMAL, scan.EXTENDED_ID)
    at = _next_cell(text, at)
    if at < 0:
        return scan.BAD
    bits = EXTENDED * (identifier > scan.STANDARD_ID)
    if scan.same_word(text, at, _TRUE):
        bits = EXTENDED
        at += len(_TRUE)
    elif scan.same_word(text, at, _FALSE):
        at += len(_FALSE)
    else:
        return scan.BAD
    if len(has_direction):
        at = _next_cell(text, at)
        if at < 0 or text[at] | scan.LOWER not in (_R, _T):
            return scan.BAD
        bits |= SENT * (text[at] | scan.LOWER == _T)
        at += 1 + (text[at + 1] not in (_COMMA, scan.NEWLINE))  # Rx or R
    bus, at = scan.number(text, _next_cell(text, at), scan.DECIMAL, 255)
    size, at = scan.number(text, _next_cell(text, at), scan.DECIMAL, FD_BYTES)
    for byte in range(size):
        value, at = scan.number(text, _next_cell(text, at), scan.HEXADECIMAL, 255)
        if byte < len(row):
            row[byte] = value
    if at < 0 or (_next_cell(text, at) < 0 and text[scan.blanks(text, at)] != scan.NEWLINE):
        return scan.BAD
    return scan.FRAME, time_ns, identifier, bits | FD * (size > CLASSIC_BYTES), bus, size, at


@compiled
def _next_cell(text: UInt8s, at: int) -> int:
    """Where the cell after the comma at ``at`` begins, blanks aside; -1: no comma."""
    if at < 0:
        return -1
    at = scan.blanks(text, at)
    return scan.blanks(text, at + 1) if text[at] == _COMMA else -1


class _Reader(TextReader):
    parse = scan.line_loop(_line)
    first_frame = re.compile(rb"\s*\d")
    has_date = False

    def begin(self) -> None:
        """The columns.

        Raises:
            LogError: the columns are not SavvyCAN's.
        """
        found = _COLUMNS.fullmatch(self.header[-1].replace(" ,", ",")) if self.header else None
        if found is None:
            first = shown(self.header[-1].encode()) if self.header else "nothing"
            raise LogError(
                f"{self.log.path}: not a CAN log: above its first frame is {first}, which must be "
                "SavvyCAN's Time Stamp,ID,Extended,Dir,Bus,LEN,D1,… (Dir may be missing)"
            )
        self.settings = np.ones(int(found[1] is not None), np.int64)

    def ended(self, line: bytes, frame: Frames) -> bool:
        """A comma after the last cell, or a byte with both its digits."""
        return bool(_WHOLE.search(line))


def _write(chunks: Iterable[Frames], path: Path, _start_ns: int, _final: Path) -> None:
    with path.open("w", encoding="ascii", newline="") as file:
        file.write(_HEADER)
        for frames in chunks:
            file.write("".join(_lines(frames)))


def _lines(frames: Frames) -> Iterator[str]:
    buses = [channel2int(name) or 0 for name in frames.channels]
    text = frames.data[:, :CLASSIC_BYTES].tobytes().hex(",", 1).upper()
    width = 3 * CLASSIC_BYTES  # two digits and a comma a byte
    for row, (time_ns, identifier, flags, channel, length) in enumerate(frames.rows()):
        yield (
            f"{(time_ns + 500) // 1000},{identifier:08X},"
            f"{'true' if flags & EXTENDED else 'false'},{'Tx' if flags & SENT else 'Rx'},"
            f"{buses[channel]},{length},{text[row * width : (row + 1) * width - 1]},\n"
        )


SAVVYCAN: Final = Format(
    key=".csv",
    mark=re.compile(rb"\W*time stamp,\s*id,\s*extended", re.I),
    read=_Reader.of,
    write=_write,
    name="SavvyCAN's CSV",
    time_ns=1_000,
    lacks=ERROR | REMOTE | FD,
)
