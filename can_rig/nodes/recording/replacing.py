"""A log that a node records in place of an earlier one, which stands until the node has ended."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from can_rig.files import refuse_existing
from can_rig.folders import Kind, NewFolder
from can_rig.logs.plant_signals import plant_signals_path
from can_rig.nodes.progress import OnTick
from can_rig.nodes.recording.recorder import is_stream


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
