"""A log that a node records in place of an earlier one, which stands until the node has ended."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from can_rig.files import refuse_existing
from can_rig.folders import Kind
from can_rig.logs.plant_signals import plant_signals_path
from can_rig.new_folder import NewFolder
from can_rig.nodes.recording.recorder import is_stream


@contextmanager
def recorded_log(log: Path | None, force: bool) -> Iterator[Path | None]:
    """Where to record ``log`` and the plant's signals beside it.

    In their own places if nothing is there, otherwise in the folder ``LOG.unfinished``, from which
    they replace the earlier ones at the end, however the node ends, if anything was recorded.

    Args:
        log: the log, or a pipe or a device; None: nothing is recorded.
        force: replace an earlier log.

    Raises:
        LogError: one of the files is there, and not to be replaced.
        RunFolderError: an earlier log cannot be replaced.
    """
    if log is None or is_stream(log):
        yield log
        return
    pair = (log, plant_signals_path(log))
    for path in pair:
        refuse_existing(path, force, "--log")
    if not any(path.exists() or path.is_symlink() for path in pair):
        yield log
        return
    kind = Kind(
        "this log",
        log.name,
        lambda _: [path.name for path in pair],
        lambda folder: (folder / log.name).is_file() and (folder / log.name).stat().st_size > 0,
    )
    with NewFolder.files_of(log.parent, log.name, kind) as made:
        try:
            yield made.making / log.name
        finally:
            if kind.recorded(made.making):
                made.publish()
            else:
                made.give_up()
