"""How far something is, for a person who waits: one bar, on standard error.

Where standard error is no terminal there is none. It is drawn when it is told something and by no
thread of its own, so a process with a bar can fork.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from can_rig.logs.frames import Frames
from can_rig.logs.log import Log

EVERY_S = 0.1
"""At most so often is it drawn, and once more at the end."""


class Bar:
    """A bar with what is done, the rate and the time left."""

    def __init__(self, progress: Progress, what: str, unit: str) -> None:
        self._progress = progress
        self._unit = unit
        self._task = progress.add_task(what, total=1.0, count="")
        self._start_s = self._drawn_s = time.monotonic()

    def count(self, done: int, of: int) -> None:
        """``done`` of a known number are done."""
        self._show(done, f"{done:,}/{of:,}", done / of)

    def share(self, done: int, share: float) -> None:
        """``done`` are done of nobody knows how many, which is this share of it all."""
        self._show(done, f"{done:,}", share)

    def _show(self, done: int, count: str, share: float) -> None:
        now_s = time.monotonic()
        rate = done / max(now_s - self._start_s, 1e-9)
        text = f"{count} {self._unit}, {rate:,.0f}/s"
        self._progress.update(self._task, completed=share, count=text)
        if now_s - self._drawn_s >= EVERY_S:
            self._drawn_s = now_s
            self._progress.refresh()


@contextmanager
def progress(what: str, unit: str) -> Iterator[Bar]:
    """A bar called ``what`` that counts ``unit``, as in "ticks"."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[count]}"),
        TimeRemainingColumn(),
    )
    quiet = not console.is_terminal
    with Progress(*columns, console=console, auto_refresh=False, disable=quiet) as shown:
        yield Bar(shown, what, unit)


@contextmanager
def counting(what: str, unit: str, of: int) -> Iterator[Callable[[int], None]]:
    """A bar of a known number; yields what is told how many are done."""
    with progress(what, unit) as bar:
        yield lambda done: bar.count(done, of)


def reading(log: Log, what: str) -> Iterator[Frames]:
    """The chunks of ``log``, behind a bar."""
    with progress(what, "frames") as bar:
        frames = 0
        for chunk in log:
            yield chunk
            frames += len(chunk)
            bar.share(frames, log.fraction)
        bar.share(frames, 1.0)
