"""Logs of any common format as columns of frames, chunk by chunk.

    for frames in read_log(Path("drive.log")):
        print(len(frames), frames.time_ns[0])

| suffix            | format                       | read by                                   |
|-------------------|------------------------------|-------------------------------------------|
| `.log`, `.log.gz` | candump -L, candump -l       | `candump`, exact to the nanosecond        |
| `.asc`, `.asc.gz` | Vector ASCII                 | python-can                                |
| `.blf`            | Vector binary                | python-can                                |
| `.trc`, `.trc.gz` | PEAK                         | python-can                                |
| `.mf4`            | ASAM MDF 4, bus logging      | asammdf                                   |

Time stamps are whole nanoseconds. Text is read digit by digit in a candump log; the other readers
give float seconds since the start of the recording, which are rounded to the nearest nanosecond
and added to the start.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from can_rig.errors import LogError
from can_rig.logs.frames import Frames

SUFFIXES = (".log", ".asc", ".blf", ".trc", ".mf4")
COMPRESSED = (".log", ".asc", ".trc")  # what may end in .gz beside


@dataclass
class Log:
    """A log, to be iterated over as often as wanted; each chunk is a `Frames`.

    Raises (while it is iterated over):
        LogError: the file cannot be read, or is not what its name says; one line with the place.
    """

    path: Path
    chunk_frames: int = 1 << 18
    """Most frames in a chunk."""
    start_ns: int = field(default=0, init=False)
    """When the recording began, on the clock of ``time_ns``: since 1970 (UTC) where the file says
    when, else 0. Known with the first chunk. Of a candump log, which has no header, the time
    stamp of its first frame."""
    notice: str | None = field(default=None, init=False)
    """One line once the end is reached and something is missing there; all whole frames came."""
    fraction: float = field(default=0.0, init=False)
    """How much of the file is read, 0..1."""

    def __iter__(self) -> Iterator[Frames]:
        self.start_ns, self.notice, self.fraction = 0, None, 0.0
        kind = format_of(self.path)
        if not self.path.exists():
            raise LogError(f"{self.path}: there is no such file")
        if self.path.is_dir():
            raise LogError(f"{self.path}: is a folder; a log file is right")
        return _reader(kind)(self)


def _reader(kind: str) -> Callable[[Log], Iterator[Frames]]:
    """The reader of a format; each imports much, and is imported where it is wanted."""
    if kind == ".log":
        from can_rig.logs.candump import read_candump  # noqa: PLC0415

        return read_candump
    if kind == ".mf4":
        from can_rig.logs.mf4 import read_mf4  # noqa: PLC0415

        return read_mf4
    from can_rig.logs import python_can  # noqa: PLC0415

    readers = {".asc": "read_asc", ".blf": "read_blf", ".trc": "read_trc"}
    reader: Callable[[Log], Iterator[Frames]] = getattr(python_can, readers[kind])
    return reader


def read_log(path: str | Path, chunk_frames: int = 1 << 18) -> Log:
    """The log at ``path``, by its suffix.

    Args:
        path: ``.log``, ``.asc``, ``.blf``, ``.trc`` or ``.mf4``; text also with ``.gz`` behind.
        chunk_frames: most frames in a chunk, which bounds the memory.

    Raises:
        LogError: the suffix is none of those.
    """
    log = Log(Path(path), chunk_frames)
    format_of(log.path)
    return log


def format_of(path: Path) -> str:
    """The suffix that says what ``path`` is, without ``.gz``.

    Raises:
        LogError: none that is known.
    """
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    compressed = bool(suffixes) and suffixes[-1] == ".gz"
    if compressed:
        suffixes.pop()
    known = COMPRESSED if compressed else SUFFIXES
    if not suffixes or suffixes[-1] not in known:
        raise LogError(
            f"{path}: not a log that can be told by its name; {', '.join(SUFFIXES)} are right, "
            f"{', '.join(COMPRESSED)} also with .gz behind"
        )
    return suffixes[-1]
