"""Logs written in the formats that `reading` reads, from columns of frames.

    write_log(read_log("runs/demo/bus.log"), Path("demo.blf"))

`can_rig.logs.changes` tells, for each format, the losses and the refused frames. A bus gets the
number at the end of its name, as in python-can, unless another bus already has the number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path

from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing
from can_rig.logs.changes import Changes
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
    """Refuse an existing log, or a suffix without a writer.

    Args:
        path: the log.
        force: replace an existing log.
        option: the command-line option with the path.

    Raises:
        LogError: the reason.
    """
    if format_of(path) != ".log" and path.suffix.lower() == ".gz":
        raise LogError(f"{path}: a compressed log can only be written as .log.gz")
    refuse_existing(path, force, option)


def write_log(log: Log, path: Path, reading: Reading = iter, *, force: bool = False) -> Changes:
    """Write the frames of ``log`` to ``path``, in the format of its suffix; returns the losses.

    ``path`` exists, complete, when this returns, and not before.

    Args:
        log: the log to read.
        path: the log to write.
        reading: iterates over the frames, for example to filter frames or to show progress.
        force: replace an existing log.

    Raises:
        LogError: the format is unknown or cannot hold a frame; a file cannot be read or written, or
            already exists.
    """
    refuse_log(path, force)
    suffix = format_of(path)
    source = iter(reading(log))
    first = next(source, None)  # the start of the log is known from here on
    changes = Changes(log, suffix, path, first)
    chunks = changes.prepare(source if first is None else chain([first], source))
    with atomic(path, force=force) as part:
        match suffix:
            case ".log":
                write_candump(chunks, part)
            case ".asc":
                write_asc(chunks, part, changes.start_ns)
            case ".blf":
                write_blf(chunks, part, changes.start_ns)
            case ".trc":
                write_trc(chunks, part, changes.start_ns, final=path)
            case ".csv":
                write_gvret(chunks, part)
            case _:
                write_mf4(chunks, part, changes.start_ns)
    return changes
