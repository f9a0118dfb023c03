"""Logs written in the formats that `reading` reads, from columns of frames.

    write_log(read_log("runs/demo/bus.log"), Path("demo.blf"))

| suffix            | what it keeps                                                              |
|-------------------|----------------------------------------------------------------------------|
| `.log`, `.log.gz` | everything; time to 1 µs                                                   |
| `.blf`            | time to 1 ns; only the payload of error frames; buses by number            |
| `.mf4`            | everything, time to 1 ns; buses by number                                  |
| `.asc`            | time to 1 µs, its start to 1 ms; no content of error frames; buses by number |
| `.trc`            | time to 1 µs; only classic data frames, others are an error; buses by number |

The number of a bus is the one at the end of its name, as in python-can: 0 for vcan0.
"""

from __future__ import annotations

from pathlib import Path

from can_rig.errors import LogError, require
from can_rig.files import atomic, refuse_existing
from can_rig.logs.formats import format_of
from can_rig.logs.log import Log
from can_rig.logs.writers.candump import write_candump
from can_rig.logs.writers.mf4 import write_mf4
from can_rig.logs.writers.python_can import write_asc, write_blf, write_trc


def refuse_log(path: Path, force: bool) -> None:
    """Refuse a log that exists already, or whose format cannot be written.

    Raises:
        LogError: the reason.
    """
    if format_of(path) != ".log" and path.suffix.lower() == ".gz":
        raise LogError(f"{path}: a compressed log can only be written as .log.gz")
    if format_of(path) == ".mf4":
        require("asammdf", extra="logs")
    refuse_existing(path, force, "--log")


def write_log(log: Log, path: Path) -> None:
    """Write the frames of ``log`` to ``path``, in the format of its suffix.

    ``path`` exists, complete, when this returns, and not before.

    Raises:
        LogError: the format is unknown or cannot hold a frame; a file cannot be read or written.
    """
    refuse_log(path, force=True)
    with atomic(path) as part:
        match format_of(path):
            case ".log":
                write_candump(log, part)
            case ".asc":
                write_asc(log, part)
            case ".blf":
                write_blf(log, part)
            case ".trc":
                write_trc(log, part, final=path)
            case _:
                write_mf4(log, part)
