"""Frames as SavvyCAN's own CSV (GVRET): classic data frames alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from can.util import channel2int

from can_rig.logs.frames import CLASSIC_BYTES, EXTENDED, SENT, Frames

_HEADER: Final = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"


def write_gvret(chunks: Iterable[Frames], path: Path) -> None:
    """Write a log."""
    with path.open("w", encoding="ascii", newline="") as file:
        file.write(_HEADER)
        for frames in chunks:
            file.write("".join(_lines(frames)))


def _lines(frames: Frames) -> Iterator[str]:
    buses = [channel2int(name) or 0 for name in frames.channels]
    columns = (frames.time_ns, frames.arbitration_id, frames.flags, frames.channel, frames.length)
    text = frames.data[:, :CLASSIC_BYTES].tobytes().hex(",", 1).upper()
    width = 3 * CLASSIC_BYTES  # two digits and a comma a byte
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for row, (time_ns, identifier, flags, channel, length) in enumerate(rows):
        yield (
            f"{(time_ns + 500) // 1000},{identifier:08X},"
            f"{'true' if flags & EXTENDED else 'false'},{'Tx' if flags & SENT else 'Rx'},"
            f"{buses[channel]},{length},{text[row * width : (row + 1) * width - 1]},\n"
        )
