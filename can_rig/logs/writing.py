"""Logs written in the formats that `reading` reads, from columns of frames.

    write_log(read_log("runs/demo/bus.log"), Path("demo.blf"))

| suffix            | what it keeps                                                              |
|-------------------|----------------------------------------------------------------------------|
| `.log`, `.log.gz` | everything; time to 1 µs                                                   |
| `.blf`            | time to 1 ns; only the payload of error frames; buses by number            |
| `.mf4`            | everything, time to 1 ns; buses by number                                  |
| `.asc`            | time to 1 µs, its start to 1 ms; no content of error frames; buses by number |
| `.trc`            | time to 1 µs; error frames are refused; buses by number                    |
| `.csv`            | SavvyCAN: classic data frames; time to 1 µs; buses by number               |

The number of a bus is the one at the end of its name, as in python-can: 0 for vcan0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing
from can_rig.logs.formats import format_of
from can_rig.logs.frames import Frames
from can_rig.logs.log import Log
from can_rig.logs.writers.candump import write_candump
from can_rig.logs.writers.gvret import write_gvret
from can_rig.logs.writers.mf4 import write_mf4
from can_rig.logs.writers.python_can import write_asc, write_blf
from can_rig.logs.writers.trc import write_trc

Reading = Callable[[Log], Iterable[Frames]]
"""Goes through the chunks of a log."""


def refuse_log(path: Path, force: bool, option: str = "--log") -> None:
    """Refuse a log that exists already, or whose format cannot be written.

    Args:
        path: the log.
        force: replace it.
        option: the one that named it.

    Raises:
        LogError: the reason.
    """
    if format_of(path) != ".log" and path.suffix.lower() == ".gz":
        raise LogError(f"{path}: a compressed log can only be written as .log.gz")
    refuse_existing(path, force, option)


def write_log(log: Log, path: Path, reading: Reading = iter) -> int:
    """Write the frames of ``log`` to ``path``, in the format of its suffix; how many they are.

    ``path`` exists, complete, when this returns, and not before.

    Args:
        log: what is written.
        path: the log to write.
        reading: goes through the frames, to choose among them or to show how far it is.

    Raises:
        LogError: the format is unknown or cannot hold a frame; a file cannot be read or written.
    """
    refuse_log(path, force=True)
    counted = 0

    def chunks() -> Iterator[Frames]:
        nonlocal counted
        for frames in reading(log):
            counted += len(frames)
            yield frames

    with atomic(path) as part:
        match format_of(path):
            case ".log":
                write_candump(chunks(), part)
            case ".asc":
                write_asc(chunks(), part)
            case ".blf":
                write_blf(chunks(), part)
            case ".trc":
                write_trc(log, chunks(), part, final=path)
            case ".csv":
                write_gvret(log, chunks(), part, final=path)
            case _:
                write_mf4(log, chunks(), part)
    return counted
