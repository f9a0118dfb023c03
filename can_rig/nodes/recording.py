"""The files of a run: every frame in ``bus.log``, the plant's report in ``bus.plant.csv``.

In lockstep a tick reaches the disk when the next tick begins. In real time a thread writes, so that
a slow disk delays no tick. Without a bus, many ticks are written at once.
"""

import io
import math
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any, Final, Self

import can
import numpy as np
import orjson
from can.io import CanutilsLogWriter
from numpy.typing import NDArray

from can_rig.errors import RunFolderError
from can_rig.frames.codec import FRAME_BYTES
from can_rig.frames.frame_columns import UInt8s
from can_rig.logs.plant_signals import plant_signals_path
from can_rig.nodes.bus_access import OnTick
from can_rig.storage.files import refuse_existing
from can_rig.storage.folders import Kind, NewFolder
from firmware_model.compiled import compiled
from firmware_model.law.structs import FloatArray

CHANNEL: Final = "vcan0"
"""So that can-utils' canplayer needs no mapping."""


def is_stream(path: Path) -> bool:
    """Whether ``path`` is a pipe or a device, where no earlier content can be lost."""
    return path.exists() and not path.is_file() and not path.is_dir()


class LogFile:
    """A new file, a pipe or a device that lines are appended to.

    Raises:
        RunFolderError: the file is there already, or cannot be opened or written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file: IO[bytes] = path.open("wb" if is_stream(path) else "xb", 0)
        except OSError as error:
            raise RunFolderError(f"{path}: cannot be opened: {error.strerror}") from None

    def write(self, text: bytes | memoryview) -> None:
        """Hand the lines to the operating system."""
        try:
            written = self._file.write(text)
            while written < len(text):
                written += self._file.write(text[written:])
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        """Close the file; ``write`` has reported every failure."""
        with suppress(OSError):
            self._file.close()


class LaterFile(LogFile):
    """The same, written by a thread some 0.1 ms later, so that a slow disk delays no tick."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._queue: SimpleQueue[bytes | memoryview] = SimpleQueue()  # empty bytes are the last
        self._writer: threading.Thread | None = None
        self._failure: RunFolderError | None = None

    def write(self, text: bytes | memoryview) -> None:
        """Give the lines to the thread, which inherits this thread's scheduling.

        Raises:
            RunFolderError: writing has failed since the last call.
        """
        if self._failure is not None:
            raise self._failure
        if self._writer is None:
            self._writer = threading.Thread(target=self._write_all, daemon=True)
            self._writer.start()
        self._queue.put(text)

    def _write_all(self) -> None:
        while (text := self._queue.get()) and self._failure is None:
            try:
                super().write(text)
            except RunFolderError as failure:
                self._failure = failure

    def close(self) -> None:
        """Close the file after the last line.

        Raises:
            RunFolderError: writing has failed.
        """
        if self._writer is not None:
            self._queue.put(b"")
            self._writer.join()
        super().close()
        if self._failure is not None:
            raise self._failure


class CandumpLines:
    """Frames as lines of candump, in memory; times never decrease.

    Frames of the recording node are marked T, all others R.
    """

    def __init__(self) -> None:
        self.waiting: list[bytes] = []
        """Lines since the last ``take``."""
        self.time_us = 0
        """The next frame's time."""

    def at(self, time_ns: int) -> None:
        """The next frame's time, unless an earlier frame was later; the others follow by 1 µs."""
        self.time_us = max(self.time_us, time_ns // 1000)

    def record(self, message: can.Message, sent: bool) -> None:
        """Note one frame, ``sent`` by this node or received."""
        time_us = self.time_us
        self.time_us += 1  # candump's resolution keeps the frames of a tick in order
        if (
            message.is_extended_id
            or message.is_remote_frame
            or message.is_error_frame
            or message.is_fd
        ):
            self.waiting.append(_other_line(message, sent, time_us))
            return
        # A plain data frame, for a third of what python-can's writer takes.
        line = (
            f"({time_us // 1_000_000}.{time_us % 1_000_000:06d}) {CHANNEL} "
            f"{message.arbitration_id:03X}#{message.data.hex().upper()} {'T' if sent else 'R'}\n"
        )
        self.waiting.append(line.encode("ascii"))

    def add(self, lines: bytes, frames: int) -> None:
        """Note the lines of as many frames, the first at ``time_us``."""
        self.waiting.append(lines)
        self.time_us += frames

    def take(self) -> bytes:
        """The lines that wait."""
        lines = b"".join(self.waiting)
        self.waiting.clear()
        return lines


class Recorder(CandumpLines):
    """Writes candump lines into a file of the given kind.

    Virtual time has the n-th frame of tick k at k·T + n µs; real time counts from the start of the
    run. Time never goes back: where others flood the bus, a tick may start in the log later than
    k·T.

    Raises:
        RunFolderError: the file cannot be opened or written.
    """

    def __init__(self, path: Path, kind: type[LogFile] = LogFile) -> None:
        super().__init__()
        self._file = kind(path)

    def flush(self) -> None:
        """Write the recorded lines; raises as ``write`` of the file does."""
        if lines := self.take():
            self._file.write(lines)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.flush()
        finally:
            self._file.close()


def _other_line(message: can.Message, sent: bool, time_us: int) -> bytes:
    """The line of an extended, remote, error or FD frame, by python-can's own writer."""
    message.timestamp, message.channel, message.is_rx = time_us * 1e-6, CHANNEL, not sent
    text = io.StringIO()
    CanutilsLogWriter(text).on_message_received(message)
    line = text.getvalue()
    if message.is_remote_frame and message.dlc:  # how many bytes it asks for: not in that line
        line = line.replace("#R", f"#R{message.dlc}")
    return line.encode("ascii")


_HEXADECIMAL: Final = np.frombuffer(b"0123456789ABCDEF", np.uint8)
_CHANNEL: Final = np.frombuffer(f") {CHANNEL} ".encode("ascii"), np.uint8)
_SECONDS_DIGITS: Final = 10
LINE_BYTES: Final = 1 + _SECONDS_DIGITS + 7 + len(f") {CHANNEL} 7FF#") + 2 * FRAME_BYTES + 3
"""No line of a classic frame with an 11-bit identifier is longer."""


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
    text = np.empty(int(there.sum()) * LINE_BYTES, dtype=np.uint8)
    words = data.view("<i8")[:, :, 0]
    return text[: _lines(words, there, first_us, np.array(ids), own, text)].data


@compiled
def _lines(words: Any, there: Any, first_us: Any, ids: Any, own: int, text: Any) -> int:
    at = 0
    for tick in range(words.shape[0]):
        time_us = first_us[tick]
        for frame in range(words.shape[1]):
            if there[tick, frame]:
                at = write_line(text, at, time_us, ids[frame], words[tick, frame], frame < own)
                time_us += 1
    return at


@compiled
def write_line(text: Any, at: int, time_us: int, identifier: int, data: int, sent: bool) -> int:
    """Write the candump line of a classic frame of 8 bytes; returns the place after the line.

    Args:
        text: for the line, characters.
        at: the place of the line in ``text``.
        time_us: the frame's time.
        identifier: of 11 bits.
        data: the frame's bytes, the lowest first.
        sent: by the recording node.
    """
    text[at] = 40  # (
    seconds, part = time_us // 1_000_000, time_us % 1_000_000
    digits, rest = 1, seconds // 10
    while rest > 0:
        digits += 1
        rest //= 10
    for place in range(digits):
        text[at + digits - place] = 48 + seconds % 10
        seconds //= 10
    at += digits + 1
    text[at] = 46  # .
    for place in range(6):
        text[at + 6 - place] = 48 + part % 10
        part //= 10
    at += 7
    for byte in _CHANNEL:
        text[at] = byte
        at += 1
    for digit in range(3):
        text[at + digit] = _HEXADECIMAL[identifier >> (8 - 4 * digit) & 15]
    text[at + 3] = 35  # #
    at += 4
    for byte in range(FRAME_BYTES):
        text[at] = _HEXADECIMAL[data >> (8 * byte + 4) & 15]
        text[at + 1] = _HEXADECIMAL[data >> (8 * byte) & 15]
        at += 2
    text[at] = 32
    text[at + 1] = 84 if sent else 82  # T, R
    text[at + 2] = 10
    return at + 3


class PlantRecorder:
    """Writes the plant's signals beside the log of its frames.

    Args:
        log: the log; the file has its name with another ending.
        kind: of the file.

    Raises:
        RunFolderError: the file is there already, or cannot be opened or written.
    """

    def __init__(self, log: Path, kind: type[LogFile] = LogFile) -> None:
        self._file = kind(plant_signals_path(log))
        self._names: tuple[str, ...] = ()

    def record(self, tick: int, signals: Mapping[str, float]) -> None:
        """Note the signals of ``tick``, the same ones in each."""
        if not self._names:
            self._write_names(signals)
        if tuple(signals) != self._names:  # another order, or a signal less
            signals = {name: signals.get(name, math.nan) for name in self._names}
        self._write_rows([(tick, *signals.values())])

    def record_columns(self, first_tick: int, columns: Mapping[str, FloatArray]) -> None:
        """Note the signals of the ticks from ``first_tick`` on, (ticks,) each."""
        if not self._names:
            self._write_names(columns)
        values = [column.tolist() for column in columns.values()]
        ticks = range(first_tick, first_tick + len(values[0]))
        self._write_rows(list(zip(ticks, *values, strict=True)))

    def _write_names(self, names: Iterable[str]) -> None:
        self._names = tuple(names)
        self._file.write(",".join(("tick", *self._names)).encode() + b"\n")

    def _write_rows(self, rows: Sequence[tuple[float, ...]]) -> None:
        """Rows of a tick and its signals, in as few digits as tell each value from all others."""
        # An interpreted plant gives NumPy's numbers, which orjson does not take for floats.
        text = orjson.dumps(rows, default=float)[2:-2].replace(b"],[", b"\n")
        if b"null" in text:  # JSON has no inf and no nan
            lines = zip(text.split(b"\n"), rows, strict=True)
            text = b"\n".join(
                ",".join(map(str, row)).encode() if b"null" in line else line for line, row in lines
            )
        self._file.write(text + b"\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(RunFolderError):  # the log has said that a disk is full
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
