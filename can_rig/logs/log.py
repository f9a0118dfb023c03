"""One log file: its path, its reader, and facts that reading reveals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
    reader: Callable[[Log], Iterator[Frames]] = field(repr=False)
    """Reads the format of the file."""
    chunk_frames: int
    """Largest number of frames in a chunk."""
    format: str
    """As a suffix: the format by content, whatever the file's name."""
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
        return self._within(self.reader(self))

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
