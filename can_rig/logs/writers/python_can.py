"""Logs of Vector, through python-can's writers.

Both writers get time stamps in seconds since the start of the recording, not since 1970: float64
keeps them exact.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Final

from can import Message
from can.io import ASCWriter, BLFWriter

from can_rig.logs.frames import NS_PER_S, Frames

_HALF_NS: Final = 5e-10


class _AscWriter(ASCWriter):
    def _format_header_datetime(self, dt: datetime) -> str:
        """A date with three digits of milliseconds: python-can writes 7 ms as ``.7``."""
        return dt.strftime(f"%a %b %d %H:%M:%S.{dt.microsecond // 1000:03d} %Y")


def write_asc(chunks: Iterable[Frames], path: Path, start_ns: int) -> None:
    """Write a Vector ASCII log that starts at ``start_ns``, whole milliseconds."""
    with _AscWriter(path) as writer:
        writer.log_event("Start of measurement", start_ns / NS_PER_S)
        writer.started = 0.0
        for message in _since(chunks, start_ns):
            writer.on_message_received(message)


def write_blf(chunks: Iterable[Frames], path: Path, start_ns: int) -> None:
    """Write a Vector binary log that starts at ``start_ns``, whole milliseconds."""
    with BLFWriter(path) as writer:
        writer.start_timestamp = last_s = 0.0
        for message in _since(chunks, start_ns):
            last_s = message.timestamp
            message.timestamp += _HALF_NS  # the writer cuts off what is below 1 ns
            writer.on_message_received(message)
        writer.start_timestamp = start_ns / NS_PER_S
        writer.stop_timestamp = writer.start_timestamp + last_s


def _since(chunks: Iterable[Frames], start_ns: int) -> Iterator[Message]:
    """Each frame as a message, with time stamps since ``start_ns``."""
    for frames in chunks:
        for message, time_ns in zip(frames.messages(), frames.time_ns.tolist(), strict=True):
            message.timestamp = (time_ns - start_ns) / NS_PER_S
            yield message
