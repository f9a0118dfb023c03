"""What every command prints alike: tables, lines, notes, errors, JSON, and one progress bar.

The bar is on standard error. Without a terminal on standard error no bar appears. Only calls redraw
the bar, never a thread, so a process with a bar can fork.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from textwrap import wrap
from typing import TYPE_CHECKING, TextIO

from rich import console as rich_console
from rich.cells import cell_len
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from can_rig.errors import UNREAD

if TYPE_CHECKING:  # NumPy and python-can are not needed to print
    from can_rig.logs.frames import Frames, Log


class Console(rich_console.Console):
    """A console that ends a command by a status of its own where nobody reads the output."""

    def on_broken_pipe(self) -> None:
        """End; rich ends with 1, which is a command's no."""
        with suppress(SystemExit):
            super().on_broken_pipe()
        sys.exit(UNREAD)


WIDE = 10_000
"""Most characters of a line of a wide table, wherever it goes."""


def table(*headings: str, left: int = 1, title: str | None = None, no_wrap: bool = False) -> Table:
    """A table without a frame; the first ``left`` columns hold text, the others numbers."""
    made = Table(box=None, pad_edge=False, title=title, show_header=any(headings))
    for index, heading in enumerate(headings):
        made.add_column(heading, justify="left" if index < left else "right", no_wrap=no_wrap)
    return made


def show(*tables: Table, wide: bool = False) -> None:
    """Tables as wide as the terminal, or as their longest words: cells break, no word is cut.

    In a ``wide`` table no cell breaks either.
    """
    for each in tables:
        console, longest = Console(highlight=False, emoji=False, markup=False), 0
        for column in each.columns:
            words = " ".join([str(column.header), *map(str, column.cells)]).split()
            column.min_width = max(map(cell_len, words), default=0)
            longest += column.min_width + 2
        console.width = WIDE if wide else max(console.width, longest)
        console.print(each, crop=False, soft_wrap=wide)


def show_beside(headings: tuple[str, ...], *rows: tuple[str, ...]) -> None:
    """A table in as many parts, one below the other, as keep every cell on one line."""
    widths = [max(map(len, column)) + 2 for column in zip(headings, *rows, strict=True)]
    room, shown = Console().width + 2 - widths[0], 1  # no space after the last column
    while shown < len(headings):
        end = shown + 1
        while end < len(headings) and sum(widths[shown : end + 1]) <= room:
            end += 1
        part = table(*(headings[i] for i in (0, *range(shown, end))), no_wrap=True)
        for row in rows:
            part.add_row(row[0], *row[shown:end])
        say(*([""] if shown > 1 else []))
        show(part)
        shown = end


def show_pairs(rows: list[tuple[str, str]]) -> None:
    """Labels and, at the right, their values; on lines of their own where both are too long."""
    natural = max(len(label) for label, _ in rows) + 2 + max(len(value) for _, value in rows)
    width = min(natural, Console().width)
    for label, value in rows:
        if len(label) + 2 + len(value) <= width:
            say(f"{label}{value:>{width - len(label)}}")
        else:
            say(*wrap(label, width, subsequent_indent="    "))
            say(*(f"{line:>{width}}" for line in wrap(value, width)))


def say(*lines: str) -> None:
    """Print lines on standard output verbatim: no truncation, no markup."""
    _print(Console(), lines)


def explain(*lines: str) -> None:
    """Sentences on standard output, broken where the terminal ends."""
    for line in lines:
        Console().print(line, markup=False, highlight=False, emoji=False)


def tell(*lines: str) -> None:
    """Lines on standard error, beside a result that a program may read."""
    _print(Console(stderr=True), lines)


def note(*texts: str | None) -> None:
    """Print additional information for the user on standard error; None prints no line."""
    _print(Console(stderr=True), [f"note: {text}" for text in texts if text], "yellow")


def complain(text: str) -> None:
    """Print an error as one line on standard error; what no terminal prints is escaped."""
    shown = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)
    _print(Console(stderr=True), [f"error: {shown}"], "red")


_for_json: list[TextIO] = []
"""Standard output, where only JSON goes there."""


def only_json() -> None:
    """From here on everything but JSON that is printed goes to standard error.

    That holds for the user's classes, libraries and FMUs too, also in processes started later.
    """
    out, err = sys.__stdout__, sys.__stderr__
    if out is None or err is None or sys.stdout is not out or _for_json:
        return
    out.flush()
    _for_json.append(os.fdopen(os.dup(out.fileno()), "w", encoding=out.encoding))
    os.dup2(err.fileno(), out.fileno())


def json_line(**values: object) -> None:
    """Print one line of JSON on standard output, without buffering."""
    stream = _for_json[0] if _for_json else sys.stdout
    plain = stream is None or "utf" not in stream.encoding.lower()
    print(json.dumps(values, ensure_ascii=plain), file=stream, flush=True)


def _print(console: Console, lines: list[str] | tuple[str, ...], style: str | None = None) -> None:
    for line in lines:
        console.print(line, style=style, soft_wrap=True, markup=False, highlight=False, emoji=False)


EVERY_S = 0.1
"""At most so often is it drawn, and once more at the end."""

LONG_S = 1.0
"""What takes less has no bar where that is the rule."""


class Bar:
    """A bar with completed count, rate and remaining time, which appears after ``after_s``."""

    def __init__(self, progress: Progress, what: str, unit: str, after_s: float) -> None:
        self._progress = progress
        self._unit = unit
        self._task = progress.add_task(what, total=1.0, count="")
        self._start_s = self._drawn_s = time.monotonic()
        self._after_s = after_s

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
        if now_s - self._start_s >= self._after_s:
            self._progress.start()  # unless the bar is there already
        if now_s - self._drawn_s >= EVERY_S:
            self._drawn_s = now_s
            self._progress.refresh()


@contextmanager
def progress(what: str, unit: str, after_s: float = 0.0) -> Iterator[Bar]:
    """A bar named ``what``, counting ``unit`` such as "ticks"; hidden before ``after_s``."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[count]}"),
        TimeRemainingColumn(),
    )
    quiet = not console.is_terminal
    shown = Progress(*columns, console=console, auto_refresh=False, disable=quiet)
    if not after_s:
        shown.start()
    try:
        yield Bar(shown, what, unit, after_s)
    finally:
        if shown.live.is_started:
            shown.stop()


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
