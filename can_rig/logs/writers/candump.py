"""Frames as lines of ``candump -L``, plain or gzipped."""

from __future__ import annotations

import gzip
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from can_rig.logs.frames import ERROR, EXTENDED, FD, REMOTE, SENT, Frames

_ERROR_BIT: Final = 1 << 29
_FD_FLAGS_SHIFT: Final = 4  # of BITRATE_SWITCH and ERROR_STATE, in candump's order


def write_candump(chunks: Iterable[Frames], path: Path) -> None:
    """Write a log; gzipped, without a date of its own, if the name ends in ``.gz``."""
    compressed = path.suffix.lower() == ".gz"
    with gzip.GzipFile(path, "wb", mtime=0) if compressed else path.open("wb") as file:
        for frames in chunks:
            file.write("".join(candump_lines(frames)).encode("ascii"))


def candump_lines(frames: Frames) -> Iterator[str]:
    """The line of each frame as ``candump -L`` writes it, followed by R or T."""
    columns = (frames.time_ns, frames.arbitration_id, frames.flags, frames.channel, frames.length)
    text = frames.data.tobytes().hex().upper()
    width = 2 * frames.data.shape[1]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for row, (time_ns, identifier, flags, channel, length) in enumerate(rows):
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
