"""The files of a run: every frame in ``bus.log``, the plant's report in ``bus.plant.csv``.

In lockstep a tick reaches the disk when the next tick begins. In real time a thread writes, so that
a slow disk delays no tick. Without a bus, many ticks are written at once.
"""

from __future__ import annotations

import io
import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Final, Protocol, Self

import can
import numpy as np
import orjson
from can.io import CanutilsLogWriter
from numpy.typing import NDArray

from can_rig.errors import RunFolderError
from can_rig.files import refuse_existing
from can_rig.folders import Kind, NewFolder
from can_rig.frames.frame_columns import UInt8s
from can_rig.frames.protection import FRAME_BYTES
from can_rig.logs.plant_signals import plant_signals_path
from can_rig.nodes.clock import OnTick
from firmware_model.compiled import compiled
from firmware_model.target.structs import FloatArray

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


HEXADECIMAL: Final = np.frombuffer(b"0123456789ABCDEF", np.uint8)
SECONDS_DIGITS: Final = 10
LINE_BYTES: Final = 1 + SECONDS_DIGITS + 7 + len(f") {CHANNEL} 7FF#") + 2 * FRAME_BYTES + 3
"""No line is longer."""


def candump_bytes(
    data: UInt8s,
    there: NDArray[np.bool_],
    first_us: NDArray[np.int64],
    ids: Sequence[int],
    own: int,
) -> memoryview:
    """The lines of all frames that are there, the n-th of a tick n µs after its first.

    Args:
        data: (ticks, frames, 8), payloads in their order on the bus.
        there: (ticks, frames), whether a frame was sent.
        first_us: (ticks,), when each tick begins, µs.
        ids: the identifier of each frame of a tick.
        own: how many of the first ones the recording node has sent itself.
    """
    heads = np.frombuffer(
        b"".join(f") {CHANNEL} {identifier:03X}#".encode("ascii") for identifier in ids), np.uint8
    ).reshape(len(ids), -1)
    text = np.empty(int(there.sum()) * LINE_BYTES, dtype=np.uint8)
    length = _lines(data, there, first_us, heads, own, text)
    return text[:length].data


@compiled
def _lines(data: Any, there: Any, first_us: Any, heads: Any, own: int, text: Any) -> int:
    zero, at = 48, 0
    for tick in range(data.shape[0]):
        time_us = first_us[tick]
        for frame in range(data.shape[1]):
            if not there[tick, frame]:
                continue
            text[at] = 40  # (
            at += 1
            seconds, part = time_us // 1_000_000, time_us % 1_000_000
            digits, rest = 1, seconds // 10
            while rest > 0:
                digits += 1
                rest //= 10
            for place in range(digits):
                text[at + digits - 1 - place] = zero + seconds % 10
                seconds //= 10
            at += digits
            text[at] = 46  # .
            for place in range(6):
                text[at + 6 - place] = zero + part % 10
                part //= 10
            at += 7
            for byte in heads[frame]:
                text[at] = byte
                at += 1
            for byte in data[tick, frame]:
                text[at] = HEXADECIMAL[byte >> 4]
                text[at + 1] = HEXADECIMAL[byte & 15]
                at += 2
            text[at] = 32
            text[at + 1] = 84 if frame < own else 82  # T, R
            text[at + 2] = 10
            at += 3
            time_us += 1
    return at


BUFFER: Final = 1 << 20
"""Bytes between two writes: a slow disk holds up no more than one tick in ten thousand."""


class PlantRecorder:
    """Writes the plant's signals beside the log of its frames.

    Args:
        log: the log; the file has its name with another ending.

    Raises:
        RunFolderError: the file is there already, or cannot be opened or written.
    """

    def __init__(self, log: Path) -> None:
        self._path = plant_signals_path(log)
        self._names: tuple[str, ...] = ()
        try:
            self._file = self._path.open("xb", BUFFER)
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be opened: {error.strerror}") from None

    def record(self, tick: int, signals: Mapping[str, float]) -> None:
        """Note the signals of ``tick``, the same ones in each."""
        names = self._names or tuple(signals)
        self._write(names, [(tick, *(signals.get(name, math.nan) for name in names))])

    def record_columns(self, first_tick: int, columns: Mapping[str, FloatArray]) -> None:
        """Note the signals of the ticks from ``first_tick`` on, (ticks,) each."""
        values = [column.tolist() for column in columns.values()]
        ticks = range(first_tick, first_tick + len(values[0]))
        self._write(tuple(columns), list(zip(ticks, *values, strict=True)))

    def _write(self, names: tuple[str, ...], rows: Sequence[tuple[float, ...]]) -> None:
        """Rows of a tick and its signals, in as few digits as tell each value from all others."""
        # A plant that runs interpreted has numbers of NumPy's, which are floats to all but orjson.
        text = orjson.dumps(rows, default=float)[2:-2].replace(b"],[", b"\n")
        if b"null" in text:  # JSON has no inf and no nan
            text = "\n".join(",".join(map(str, row)) for row in rows).encode()
        try:
            if not self._names:
                self._names = names
                self._file.write(",".join(("tick", *names)).encode() + b"\n")
            self._file.write(text + b"\n")
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
        with suppress(OSError):  # a full disk has been said by ``record``, or by the log
            self._file.close()


class RealTimeRecorder:
    """Writes candump lines with the time since the start of the run.

    ``at`` sets the time of the next frame, sent or read. ``flush`` gives the thread all recorded
    lines, which reach the disk some 0.1 ms later.

    Raises:
        RunFolderError: the file cannot be opened or written.
    """

    def __init__(self, path: Path) -> None:
        self._file = LogFile(path)
        self._lines = CandumpLines()
        self.record = self._lines.record
        self._queue: SimpleQueue[list[str]] = SimpleQueue()  # an empty list is the last
        self._writer: threading.Thread | None = None
        self._failure: RunFolderError | None = None

    def at(self, time_ns: int) -> None:
        """Set the next frame's time since the start; times never decrease."""
        self._lines.at(time_ns // 1000)

    def flush(self) -> None:
        """Give the recorded lines to the thread, which inherits this thread's scheduling.

        Raises:
            RunFolderError: writing has failed since the last call.
        """
        if self._failure is not None:
            raise self._failure
        lines = self._lines.take()
        if not lines:
            return
        if self._writer is None:
            self._writer = threading.Thread(target=self._write_all, daemon=True)
            self._writer.start()
        self._queue.put(lines)

    def _write_all(self) -> None:
        while (lines := self._queue.get()) and self._failure is None:
            try:
                self._file.write(lines)
            except RunFolderError as failure:
                self._failure = failure

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.flush()
            if self._writer is not None:
                self._queue.put([])
                self._writer.join()
            if self._failure is not None:
                raise self._failure
        finally:
            self._file.close()


@dataclass
class Recording:
    """Where a node records, and how far it got."""

    path: Path | None
    """The log; None: nothing is recorded."""
    ticks: int = 0

    def before(self, on_tick: OnTick) -> OnTick:
        """``on_tick``, which also counts here."""

        def counted(tick: int) -> None:
            self.ticks = tick
            on_tick(tick)

        return counted


@contextmanager
def recorded_log(log: Path | None, force: bool) -> Iterator[Recording]:
    """Record ``log`` and the plant's signals beside it.

    New files are written in their places. Files that replace earlier ones are written in the folder
    ``LOG.unfinished``. They replace the earlier ones when the node has ended, after one tick or
    more.

    Args:
        log: the log, or a pipe or a device; None: nothing is recorded.
        force: replace an earlier log.

    Raises:
        LogError: one of the files exists and ``force`` is not given.
        RunFolderError: an earlier log cannot be replaced.
    """
    if log is None or is_stream(log):
        yield Recording(log)
        return
    pair = (log, plant_signals_path(log))
    for path in pair:
        refuse_existing(path, force, "--log")
    if not any(path.exists() or path.is_symlink() for path in pair):
        yield Recording(log)
        return
    kind = Kind(
        "this log",
        log.name,
        lambda _: [path.name for path in pair],
        lambda folder: (folder / log.name).is_file() and (folder / log.name).stat().st_size > 0,
    )
    with NewFolder.files_of(log.parent, log.name, kind) as made:
        recording = Recording(made.making / log.name)
        try:
            yield recording
        finally:
            if recording.ticks:
                made.publish()
            else:
                made.give_up()
