"""``bus.log``: every frame that the plant node sends or sees, on disk tick by tick."""

from __future__ import annotations

import io
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Protocol, Self

import can
from can.io import CanutilsLogWriter

from can_rig.errors import RunFolderError

CHANNEL: Final = "vcan0"
"""So that can-utils' canplayer needs no mapping."""


class Log(Protocol):
    """What frames are recorded in."""

    def record(self, message: can.Message, sent: bool) -> None:
        """Note one frame, ``sent`` by this node or received."""


def is_stream(path: Path) -> bool:
    """Whether what is written there goes to a pipe or a device, which have nothing to lose."""
    return path.exists() and not path.is_file() and not path.is_dir()


class LogFile:
    """A new file, a pipe or a device that lines are appended to.

    Raises:
        RunFolderError: the file is there already, or cannot be opened or written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("wb" if is_stream(path) else "xb")
        except OSError as error:
            raise RunFolderError(f"{path}: cannot be opened: {error.strerror}") from None

    def write(self, lines: list[str]) -> None:
        """Hand the lines to the operating system."""
        self.write_bytes("".join(lines).encode("ascii"))

    def write_bytes(self, text: bytes | memoryview) -> None:
        """The same of lines that are joined and encoded."""
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        """Close it; what could not be written has been said by ``write``."""
        with suppress(OSError):
            self._file.close()


class CandumpLines:
    """Frames as lines of candump, in memory; no frame is earlier than the one before it.

    Frames of the recording node are marked T, all others R.
    """

    def __init__(self) -> None:
        self.waiting: list[str] = []
        """Lines since the last ``take``."""
        self._time_us = 0
        self._heads: dict[int, str] = {}  # identifier → what stands between time and data

    def at(self, time_us: int) -> None:
        """The next frame's time, unless an earlier frame was later; the others follow by 1 µs."""
        self._time_us = max(self._time_us, time_us)

    def record(self, message: can.Message, sent: bool) -> None:
        """Note one frame, ``sent`` by this node or received."""
        time_us = self._time_us
        self._time_us += 1  # candump's resolution keeps the frames of a tick in order
        if (
            message.is_extended_id
            or message.is_remote_frame
            or message.is_error_frame
            or message.is_fd
        ):
            self.waiting.append(_other_line(message, sent, time_us))
            return
        head = self._heads.get(message.arbitration_id)
        if head is None:
            head = f") {CHANNEL} {message.arbitration_id:03X}#"
            self._heads[message.arbitration_id] = head
        # A plain data frame, for a third of what python-can's writer takes.
        self.waiting.append(
            f"({time_us // 1_000_000}.{time_us % 1_000_000:06d}{head}"
            f"{message.data.hex().upper()} {'T' if sent else 'R'}\n"
        )

    def take(self) -> list[str]:
        """The lines that wait."""
        lines, self.waiting = self.waiting, []
        return lines


class Recorder:
    """Writes candump lines in virtual time: the n-th frame of tick k at k·T + n µs.

    Time never goes back: where others flood the bus, a tick may start in the log later than k·T.

    A tick's lines reach the operating system when the next one begins, so a killed process leaves
    every tick that it finished.

    Raises:
        RunFolderError: the file cannot be opened or written.
    """

    def __init__(self, path: Path, tick_ns: int) -> None:
        self._tick_ns = tick_ns
        self._file = LogFile(path)
        self._lines = CandumpLines()
        self.record = self._lines.record

    def begin_tick(self, tick: int) -> None:
        """Put the previous tick on disk; the next frame is the first of ``tick``."""
        self._file.write(self._lines.take())
        self._lines.at(tick * self._tick_ns // 1000)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self._file.write(self._lines.take())
        finally:
            self._file.close()


def _other_line(message: can.Message, sent: bool, time_us: int) -> str:
    """The line of an extended, remote, error or FD frame, by python-can's own writer."""
    message.timestamp, message.channel, message.is_rx = time_us * 1e-6, CHANNEL, not sent
    text = io.StringIO()
    CanutilsLogWriter(text).on_message_received(message)
    return text.getvalue()
