"""``bus.log``: every frame that the plant node sends or sees, on disk tick by tick."""

from __future__ import annotations

import io
from pathlib import Path
from types import TracebackType
from typing import Self

import can
from can.io import CanutilsLogWriter

from can_rig.errors import RunFolderError

CHANNEL = "vcan0"  # so that can-utils' canplayer needs no mapping


class Recorder:
    """Writes candump lines in virtual time: the n-th frame of tick k at k·T + n µs.

    A tick's lines reach the operating system when the next one begins, so a killed process leaves
    every tick that it finished. Frames of the recording node are marked T, all others R.

    Raises:
        RunFolderError: the file cannot be opened or written.
    """

    def __init__(self, path: Path, tick_ns: int) -> None:
        self._path = path
        self._tick_ns = tick_ns
        self._time_us = 0
        self._lines: list[str] = []
        self._heads: dict[int, str] = {}  # identifier → what stands between time and data
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise RunFolderError(f"{path}: cannot be opened: {error.strerror}") from None

    def begin_tick(self, tick: int) -> None:
        """Put the previous tick on disk; the next frame is the first of ``tick``."""
        self._put()
        self._time_us = tick * self._tick_ns // 1000

    def record(self, message: can.Message, sent: bool) -> None:
        """Note one frame, ``sent`` by this node or received."""
        time_us = self._time_us
        self._time_us += 1  # candump's resolution keeps the frames of a tick in order
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            self._lines.append(_other_line(message, sent, time_us))
            return
        head = self._heads.get(message.arbitration_id)
        if head is None:
            head = f") {CHANNEL} {message.arbitration_id:03X}#"
            self._heads[message.arbitration_id] = head
        # A plain data frame, for a third of what python-can's writer takes.
        self._lines.append(
            f"({time_us // 1_000_000}.{time_us % 1_000_000:06d}{head}"
            f"{message.data.hex().upper()} {'T' if sent else 'R'}\n"
        )

    def _put(self) -> None:
        try:
            self._file.write("".join(self._lines).encode("ascii"))
            self._file.flush()
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be written: {error.strerror}") from None
        self._lines.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._put()
        self._file.close()


def _other_line(message: can.Message, sent: bool, time_us: int) -> str:
    """The line of an extended, remote or error frame, by python-can's own writer."""
    message.timestamp, message.channel, message.is_rx = time_us * 1e-6, CHANNEL, not sent
    text = io.StringIO()
    CanutilsLogWriter(text).on_message_received(message)
    return text.getvalue()
