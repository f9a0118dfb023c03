"""Many CAN frames as columns, the log file that holds them, and the description of a log format."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from can import Message
from numpy.typing import NDArray

from can_rig.errors import LogError

# Bits of Frames.flags.
EXTENDED: Final = 1
REMOTE: Final = 2
ERROR: Final = 4
FD: Final = 8
BITRATE_SWITCH: Final = 16
ERROR_STATE: Final = 32
SENT: Final = 64

CLASSIC_BYTES: Final = 8
FD_BYTES: Final = 64
NS_PER_S: Final = 1_000_000_000
MAX_BUSES: Final = 255
"""In a log, so that a byte holds the index of a bus."""

UInt8s = NDArray[np.uint8]


@dataclass(frozen=True)
class Frames:
    """``n`` frames, one a row, in the order of their source."""

    time_ns: NDArray[np.int64]
    """(n,) time stamps as the source has them [ns]: see `can_rig.logs.reading.Log.start_ns`."""
    arbitration_id: NDArray[np.uint32]
    """(n,) identifiers, of 11 or 29 bits; an error frame has Linux's error class."""
    flags: UInt8s
    """(n,) EXTENDED, REMOTE, ERROR, FD, BITRATE_SWITCH, ERROR_STATE, SENT (else received)."""
    channel: UInt8s
    """(n,) indices into ``channels``."""
    length: NDArray[Any]
    """(n,) payload lengths [byte], uint8; for a remote frame, the requested length."""
    data: UInt8s
    """(n, 8) or, where a frame is longer, (n, 64) payloads; zero beyond their ends."""
    channels: tuple[str, ...]
    """Names of the buses."""

    def __len__(self) -> int:
        return len(self.time_ns)

    def __getitem__(self, rows: slice | NDArray[Any]) -> Frames:
        """Selected frames: a slice, a mask, or row numbers."""
        columns: dict[str, Any] = {name: getattr(self, name)[rows] for name in Columns._fields}
        return replace(self, **columns)

    def has(self, flag: int) -> NDArray[np.bool_]:
        """(n,) whether a frame has at least one of the flags."""
        found: NDArray[np.bool_] = (self.flags & flag) != 0
        return found

    def rows(self) -> Iterator[tuple[int, int, int, int, int]]:
        """Each frame's time stamp, identifier, flags, channel and length."""
        columns = (self.time_ns, self.arbitration_id, self.flags, self.channel, self.length)
        return zip(*(column.tolist() for column in columns), strict=True)

    def messages(self, since_ns: int = 0) -> Iterator[Message]:
        """Yield each frame as a python-can message; time stamps in float seconds after a time."""
        for row, data in zip(self.rows(), self.data, strict=True):
            time_ns, arbitration_id, flags, channel, length = row
            bare = flags & REMOTE
            yield Message(
                timestamp=(time_ns - since_ns) / NS_PER_S,
                arbitration_id=arbitration_id,
                is_extended_id=bool(flags & EXTENDED),
                is_remote_frame=bool(bare),
                is_error_frame=bool(flags & ERROR),
                channel=self.channels[channel],
                dlc=length,
                data=None if bare else bytearray(data[:length]),
                is_fd=bool(flags & FD),
                is_rx=not flags & SENT,
                bitrate_switch=bool(flags & BITRATE_SWITCH),
                error_state_indicator=bool(flags & ERROR_STATE),
            )


def concatenate(parts: Iterable[Frames]) -> Frames:
    """The parts joined in order; payloads as wide as the widest, channels by their names."""
    parts = list(parts)
    names = list(dict.fromkeys(name for part in parts for name in part.channels))
    width = max((part.data.shape[1] for part in parts), default=CLASSIC_BYTES)
    channels, payloads = [], [np.zeros((0, width), np.uint8)]
    for part in parts:
        renumber = np.array([names.index(name) for name in part.channels] or [0], dtype=np.uint8)
        channels.append(renumber[part.channel])
        payloads.append(np.pad(part.data, ((0, 0), (0, width - part.data.shape[1]))))

    def joined(name: str, kind: type[Any]) -> NDArray[Any]:
        return np.concatenate([np.zeros(0, kind), *(getattr(part, name) for part in parts)])

    return Frames(
        joined("time_ns", np.int64),
        joined("arbitration_id", np.uint32),
        joined("flags", np.uint8),
        np.concatenate([np.zeros(0, np.uint8), *channels]),
        joined("length", np.uint8),
        np.concatenate(payloads),
        tuple(names),
    )


class Columns(NamedTuple):
    """Room for frames, which compiled readers fill: the columns of `Frames`."""

    time_ns: NDArray[np.int64]
    arbitration_id: NDArray[np.uint32]
    flags: UInt8s
    channel: NDArray[Any]
    length: UInt8s
    data: UInt8s

    def frames(self, count: int, names: tuple[str, ...] = ()) -> Frames:
        """The first ``count`` frames."""
        return Frames(*self, names)[:count]


def empty_columns(rows: int, width: int, bus: type[np.unsignedinteger[Any]] = np.uint8) -> Columns:
    """Room for frames with ``width`` bytes; ``bus`` is the type of the buses' numbers."""
    return Columns(
        np.empty(rows, np.int64),
        np.empty(rows, np.uint32),
        np.empty(rows, np.uint8),
        np.empty(rows, bus),
        np.empty(rows, np.uint8),
        np.empty((rows, width), np.uint8),
    )


def numbered(frames: Frames, first: int = 0) -> Frames:
    """Frames with the bus number as ``channel``, indexed over the buses present.

    Args:
        frames: at least one frame.
        first: the format's number of the first bus; the result counts from 0, as python-can does.

    Raises:
        LogError: more buses than an index can hold.
    """
    found = np.flatnonzero(np.bincount(frames.channel))
    if len(found) > MAX_BUSES:
        raise LogError(f"{len(found)} buses; there must be at most {MAX_BUSES} in a log")
    names = tuple(str(number - first) for number in found.tolist())
    if len(found) == 1:
        return replace(frames, channel=np.zeros(len(frames), np.uint8), channels=names)
    index = np.zeros(int(found[-1]) + 1, np.uint8)
    index[found] = np.arange(len(found))
    return replace(frames, channel=index[frames.channel], channels=names)


class Window(NamedTuple):
    """A part of a recording, its end not included; since the recording began."""

    begin_ns: int
    end_ns: int


ALL: Final = Window(-(1 << 63), (1 << 63) - 1)
_MOST_S: Final = 9e9


def window_of(from_s: float | None, to_s: float | None) -> Window:
    """The part of a recording from ``from_s`` to ``to_s`` after its start; None: up to the end.

    Raises:
        LogError: the window is empty or out of range.
    """
    begin_ns, end_ns = (
        default if value is None else round(value * NS_PER_S) if abs(value) < _MOST_S else None
        for value, default in ((from_s, ALL.begin_ns), (to_s, ALL.end_ns))
    )
    if begin_ns is None or end_ns is None or begin_ns >= end_ns:
        given = {"--from": from_s, "--to": to_s}.items()
        said = " ".join(f"{name} {value}" for name, value in given if value is not None)
        raise LogError(f"{said}: must be seconds, --from before --to")
    return Window(begin_ns, end_ns)


@dataclass
class Log:
    """A log; iteration may be repeated; each chunk is a `Frames`.

    Raises (during iteration):
        LogError: the file cannot be read, its content is not of its format, or the window begins
            after the last frame; the one-line message names the file and the place.
    """

    path: Path
    format: Format = field(repr=False)
    """The format by content, whatever the file's name."""
    chunk_frames: int
    """Largest number of frames in a chunk."""
    window: Window = ALL
    """The part of the recording to read."""
    start_ns: int = field(default=0, init=False)
    """Start of the recording on the clock of ``Frames.time_ns`` [ns]: since 1970 (UTC) if the file
    gives a date, else 0. Known once the first chunk is. For a candump log, which has no header, the
    time stamp of the first frame."""
    notice: str | None = field(default=None, init=False)
    """One line if the end of the log is missing, known after the last chunk; every complete frame
    has been read nevertheless."""
    fraction: float = field(default=0.0, init=False)
    """Share of the file that the reader has consumed, 0..1."""

    def __iter__(self) -> Iterator[Frames]:
        self.start_ns, self.notice, self.fraction = 0, None, 0.0
        if not self.path.exists():
            raise LogError(f"{self.path}: there is no such file")
        if self.path.is_dir():
            raise LogError(f"{self.path}: is a folder; it must be a log file")
        if not (self.format.gzipped or self.path.is_file()):
            raise LogError(f"{self.path}: is a pipe; must be a file: only text is read in one pass")
        return self._within(self.format.read(self))

    def _within(self, chunks: Iterator[Frames]) -> Iterator[Frames]:
        """The frames within the window; chunks without any are passed over."""
        last_ns, empty = ALL.begin_ns, True
        try:
            if self.window == ALL:
                yield from chunks
                return
            for frames in chunks:
                since_ns = frames.time_ns - self.start_ns
                last_ns = max(last_ns, int(since_ns.max(initial=last_ns)))
                inside = (since_ns >= self.window.begin_ns) & (since_ns < self.window.end_ns)
                if inside.any():
                    empty = False
                    yield frames if inside.all() else frames[inside]
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}") from None
        if empty and self.window.begin_ns > last_ns != ALL.begin_ns:
            last = f"the last is at {last_ns / NS_PER_S:g} s"
            raise LogError(f"{self.path}: has no frame after --from, {last}")


Writer = Callable[[Iterable[Frames], Path, int, Path], None]
"""(frames, file to write, start of the recording [ns], the file's final name) → the file."""


@dataclass(frozen=True)
class Format:
    """A log format: how to know, read and write it, and which properties of a log a file keeps.

    The defaults stand for "everything is kept".
    """

    key: str
    """The suffix of its files; the program's name where the suffix belongs to another format."""
    mark: re.Pattern[bytes]
    """Matches the beginning of a file."""
    read: Callable[[Log], Iterator[Frames]]
    """Chunks of a log; raises LogError for another format, or a damaged file."""
    gzipped: bool = True
    """Whether ``.gz`` may follow the suffix."""
    write: Writer | None = None
    """None: the format is only read; the fields from here on are about written files."""
    name: str = ""
    time_ns: int = 1
    """Resolution of its time stamps."""
    start_ns: int | None = None
    """Resolution of the start of the recording; None: the start is the first frame's time."""
    since_ns: int | None = None
    """The earliest start that the format can express; an earlier start is written as 0."""
    before_start: bool = True
    """Whether a frame may have a time before the start."""
    bus_names: bool = False
    """Whether buses have names; else numbers."""
    lacks: int = 0
    """Frame flags that the format lacks."""
    error_direction: bool = True
    """Whether it says if an error frame was sent or received."""
    error_content: bool = True
    """Whether error frames have identifiers and payloads."""
    order: bool = True
    """Whether frames of several kinds stay in the order of the log where the time does not tell."""

    def starts(self, start_ns: int) -> int:
        """The start of a recording [ns], rounded to the format's resolution."""
        if self.start_ns is None or (self.since_ns is not None and start_ns < self.since_ns):
            return 0
        return start_ns // self.start_ns * self.start_ns
