"""Logs of Vector, through python-can's writers."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Final

from can.io import ASCWriter, BLFWriter

from can_rig.logs.frames import NS_PER_S, Frames

_HALF_NS: Final = 5e-10
_BLF_SINCE_NS: Final = 631_152_000 * NS_PER_S  # 1990: python-can writes no earlier date


def write_asc(chunks: Iterable[Frames], path: Path) -> None:
    """Write a Vector ASCII log."""
    with ASCWriter(path) as writer:
        for frames in chunks:
            for message in frames.messages():
                writer.on_message_received(message)


def write_blf(source: Iterable[Frames], path: Path) -> None:
    """Write a Vector binary log."""
    with BLFWriter(path) as writer:
        chunks = iter(source)
        first = next(chunks, None)
        if first is None:
            return
        # The header has the start to the millisecond. Relative to it time stamps stay exact, with
        # half a nanosecond added, because the writer cuts off the rest.
        start_ns = int(first.time_ns[0]) // 1_000_000 * 1_000_000
        if start_ns < _BLF_SINCE_NS:
            start_ns = 0  # the time of a simulation, not a date
        writer.start_timestamp = 0.0
        last_s = 0.0
        for frames in chain([first], chunks):
            for message, time_ns in zip(frames.messages(), frames.time_ns.tolist(), strict=True):
                last_s = (time_ns - start_ns) / NS_PER_S
                message.timestamp = last_s + _HALF_NS
                writer.on_message_received(message)
        writer.start_timestamp = start_ns / NS_PER_S
        writer.stop_timestamp = writer.start_timestamp + last_s
