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
        """Note one frame, ``sent`` by this node or received."""
        seconds, rest_ns = divmod(self._time_ns, 1_000_000_000)
        self._time_ns += FRAME_SPACING_NS
        if (
            message.is_extended_id
            or message.is_remote_frame
            or message.is_error_frame
            or message.is_fd
        ):
            self._record_other(message, sent, seconds + rest_ns * 1e-9)
            return
        # The line of a plain data frame, at half the cost of python-can's writer.
        self._writer.file.write(
            f"({seconds}.{rest_ns // 1000:06d}) {CHANNEL} {message.arbitration_id:03X}"
            f"#{message.data.hex().upper()} {'T' if sent else 'R'}\n"
        )

    def _record_other(self, message: can.Message, sent: bool, time_s: float) -> None:
        message.timestamp, message.channel, message.is_rx = time_s, CHANNEL, not sent
        self._writer.on_message_received(message)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.stop()
