"""A log file with facts that reading reveals, and the description of a log format."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from can_rig.errors import LogError
from can_rig.logs.frames import NS_PER_S, Frames


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
        raise LogError(f"--from {from_s} --to {to_s}: must be seconds, the first smaller")
    return Window(begin_ns, end_ns)


@dataclass
class Log:
    """A log; iteration may be repeated; each chunk is a `Frames`.

    Raises (during iteration):
        LogError: the file cannot be read, or its content is not of its format; the one-line message
            names the file and the place.
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
        return self._within(self.format.read(self))

    def _within(self, chunks: Iterator[Frames]) -> Iterator[Frames]:
        """The frames within the window; chunks without any are passed over."""
        if self.window == ALL:
            yield from chunks
            return
        for frames in chunks:
            since_ns = frames.time_ns - self.start_ns
            inside = (since_ns >= self.window.begin_ns) & (since_ns < self.window.end_ns)
            if inside.any():
                yield frames if inside.all() else frames[inside]


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
