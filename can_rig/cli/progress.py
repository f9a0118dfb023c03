"""How far a log is read, for a person who waits."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from can_rig.logs.frames import Frames
from can_rig.logs.log import Log


def reading(log: Log, what: str) -> Iterator[Frames]:
    """The chunks of ``log``, behind a bar on standard error with frames, rate and time left.

    Where standard error is no terminal there is none.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[frames]:,} frames, {task.fields[rate]:,.0f}/s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=1.0, frames=0, rate=0.0)
        frames = 0
        for chunk in log:
            yield chunk
            frames += len(chunk)
            elapsed_s = bar.tasks[0].elapsed or 1.0
            bar.update(task, completed=log.fraction, frames=frames, rate=frames / elapsed_s)
        bar.update(task, completed=1.0)
