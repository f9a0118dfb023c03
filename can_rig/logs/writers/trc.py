"""Frames as a PEAK trace of version 2.1: data frames, also of CAN FD, and remote frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from pathlib import Path
from typing import Final

from can.util import channel2int

from can_rig.logs.frames import (
    BITRATE_SWITCH,
    ERROR_STATE,
    EXTENDED,
    FD,
    NS_PER_S,
    REMOTE,
    SENT,
    Frames,
)

_NS_PER_DAY: Final = 86_400 * NS_PER_S
_DAYS_TO_1970: Final = 25569
_TYPES: Final = {
    0: "DT",
    FD: "FD",
    FD | BITRATE_SWITCH: "FB",
    FD | ERROR_STATE: "FE",
    FD | BITRATE_SWITCH | ERROR_STATE: "BI",
}


def write_trc(chunks: Iterable[Frames], path: Path, start_ns: int, final: Path) -> None:
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
    columns = (frames.time_ns, frames.arbitration_id, frames.flags, frames.channel, frames.length)
    rows = zip(*(column.tolist() for column in columns), frames.data, strict=True)
    for number, (time_ns, identifier, flags, channel, length, data) in enumerate(rows, before + 1):
        since_us = (time_ns - start_ns + 500) // 1000
        kind = "RR" if flags & REMOTE else _TYPES[flags & (FD | BITRATE_SWITCH | ERROR_STATE)]
        payload = "" if flags & REMOTE else data[:length].tobytes().hex(" ").upper()
        name = f"{identifier:08X}" if flags & EXTENDED else f"{identifier:04X}"
        yield (
            f"{number:>7} {since_us // 1000:>9}.{since_us % 1000:03d} {kind} {buses[channel]:>2} "
            f"{name:>8} {'Tx' if flags & SENT else 'Rx'} -  {length:<4} {payload}\n"
        )
