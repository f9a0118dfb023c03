"""``bus.log``: every frame that the plant node sends or sees, on disk tick by tick."""

from __future__ import annotations

import io
import threading
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import Self

import can
from can.io import CanutilsLogWriter

from can_rig.errors import RunFolderError

CHANNEL = "vcan0"  # so that can-utils' canplayer needs no mapping


class Recorder:
    """Writes candump lines in virtual time: the n-th frame of tick k at k·T + n µs.

    Time never goes back: where others flood the bus, a tick may start in the log later than k·T.

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
        self._time_us = max(self._time_us, tick * self._tick_ns // 1000)

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
        self._write(self._lines)
        self._lines.clear()

    def _write(self, lines: list[str]) -> None:
        try:
            self._file.write("".join(lines).encode("ascii"))
            self._file.flush()
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be written: {error.strerror}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self._put()
        finally:
            with suppress(OSError):  # again what _put has just said: its lines are still there
                self._file.close()


class RealTimeRecorder(Recorder):
    """The same lines, at the time since the start of the run, put on disk by a thread.

    A disk that stalls for a moment so stalls no tick. ``at`` says when the next frame was sent or
    read, and ``hand_over`` gives the thread what there is; it is on disk some 0.1 ms later.
    """

    def __init__(self, path: Path, tick_ns: int) -> None:
        super().__init__(path, tick_ns)
        self._queue: SimpleQueue[list[str]] = SimpleQueue()  # an empty list is the last
        self._writer: threading.Thread | None = None
        self._failure: RunFolderError | None = None

    def at(self, time_ns: int) -> None:
        """The next frame's time since the start; no frame is earlier than the one before it."""
        self._time_us = max(self._time_us, time_ns // 1000)

    def begin_tick(self, tick: int) -> None:
        """Nothing: time is the wall clock's, and the disk can wait until ``hand_over``."""

    def hand_over(self) -> None:
        """Give what was recorded to the thread, which inherits the scheduling of this one.

        Raises:
            RunFolderError: writing has failed since the last call.
        """
        if self._failure is not None:
            raise self._failure
        if not self._lines:
            return
        if self._writer is None:
            self._writer = threading.Thread(target=self._write_all, daemon=True)
            self._writer.start()
        self._queue.put(self._lines)
        self._lines = []

    def _write_all(self) -> None:
        while (lines := self._queue.get()) and self._failure is None:
            try:
                self._write(lines)
            except RunFolderError as failure:
                self._failure = failure

    def _put(self) -> None:
        """At the end: wait for the thread."""
        self.hand_over()
        if self._writer is not None:
            self._queue.put([])
            self._writer.join()
            if self._failure is not None:
                raise self._failure


def _other_line(message: can.Message, sent: bool, time_us: int) -> str:
    """The line of an extended, remote or error frame, by python-can's own writer."""
    message.timestamp, message.channel, message.is_rx = time_us * 1e-6, CHANNEL, not sent
    text = io.StringIO()
    CanutilsLogWriter(text).on_message_received(message)
    return text.getvalue()
