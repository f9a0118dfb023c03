"""Progress for a waiting user: one bar on standard error.

Without a terminal on standard error no bar appears. Only calls redraw the bar, never a thread, so a
process with a bar can fork.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from can_rig.logs.frames import Frames
from can_rig.logs.log import Log

EVERY_S = 0.1
"""At most so often is it drawn, and once more at the end."""

LONG_S = 1.0
"""What takes less has no bar where that is the rule."""


class Bar:
    """A bar with completed count, rate and remaining time.

    ``appear`` is called once, after ``after_s`` seconds.
    """

    def __init__(
        self, progress: Progress, what: str, unit: str, appear: Callable[[], object], after_s: float
    ) -> None:
        self._progress = progress
        self._unit = unit
        self._task = progress.add_task(what, total=1.0, count="")
        self._start_s = self._drawn_s = time.monotonic()
        self._appear: Callable[[], object] | None = appear
        self._after_s = after_s
        self._appear_in_time(self._start_s)

    def count(self, done: int, of: int) -> None:
        """Set the count to ``done`` of a known total."""
        self._show(done, f"{done:,}/{of:,}", done / of)

    def share(self, done: int, share: float) -> None:
        """Set the count to ``done``, about ``share`` of an unknown total."""
        self._show(done, f"{done:,}", share)

    def _show(self, done: int, count: str, share: float) -> None:
        now_s = time.monotonic()
        rate = done / max(now_s - self._start_s, 1e-9)
        text = f"{count} {self._unit}, {rate:,.0f}/s"
        self._progress.update(self._task, completed=share, count=text)
        self._appear_in_time(now_s)
        if now_s - self._drawn_s >= EVERY_S:
            self._drawn_s = now_s
            self._progress.refresh()

    def _appear_in_time(self, now_s: float) -> None:
        if self._appear is not None and now_s - self._start_s >= self._after_s:
            self._appear()
            self._appear = None


@contextmanager
def progress(what: str, unit: str, after_s: float = 0.0) -> Iterator[Bar]:
    """A bar named ``what``, counting ``unit`` such as "ticks"; hidden before ``after_s``."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[count]}"),
        TimeRemainingColumn(),
    )
    quiet = not console.is_terminal
    shown = Progress(*columns, console=console, auto_refresh=False, disable=quiet)
    with ExitStack() as stack:
        yield Bar(shown, what, unit, lambda: stack.enter_context(shown), after_s)


@contextmanager
def counting(what: str, unit: str, of: int) -> Iterator[Callable[[int], None]]:
    """A bar with a known total; yields a function that sets the count."""
    with progress(what, unit) as bar:
        yield lambda done: bar.count(done, of)


@contextmanager
def car_bar() -> Iterator[Callable[[int, int], None]]:
    """A bar for slow sets of drives; yields a function to call after each car."""
    with progress("drives", "cars", LONG_S) as bar:
        yield bar.count


def reading(log: Log, what: str) -> Iterator[Frames]:
    """The chunks of ``log``, behind a bar."""
    with progress(what, "frames") as bar:
        frames = 0
        for chunk in log:
            yield chunk
            frames += len(chunk)
            bar.share(frames, log.fraction)
        bar.share(frames, 1.0)
