"""``bus.log``: every frame that the plant node sends or sees, on disk tick by tick."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

import can
from can.io import CanutilsLogWriter

CHANNEL = "vcan0"  # so that can-utils' canplayer needs no mapping
FRAME_SPACING_NS = 1000  # candump's resolution: frames of one tick stay in order by time


class Recorder:
    """Writes candump lines in virtual time: the n-th frame of tick k at k·T + n µs.

    A tick's lines reach the operating system when the tick ends, so a killed process leaves every
    tick up to then. Frames of the recording node are marked T, all others R.
    """

    def __init__(self, path: Path, tick_ns: int) -> None:
        self._writer = CanutilsLogWriter(path, channel=CHANNEL)
        self._tick_ns = tick_ns
        self._time_ns = 0

    def begin_tick(self, tick: int) -> None:
        """Put the previous tick on disk; the next frame is the first of ``tick``."""
        self._writer.file.flush()
        self._time_ns = tick * self._tick_ns

    def record(self, message: can.Message, sent: bool) -> None:
        """Note one frame, ``sent`` by this node or received; its timestamp becomes virtual."""
        message.timestamp = self._time_ns * 1e-9
        message.channel = CHANNEL
        message.is_rx = not sent
        self._writer.on_message_received(message)
        self._time_ns += FRAME_SPACING_NS

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.stop()
