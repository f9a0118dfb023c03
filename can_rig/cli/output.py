"""What every command prints alike: tables, lines, notes, errors and JSON."""

from __future__ import annotations

import json
import sys
from textwrap import wrap

from rich.console import Console
from rich.table import Table

WIDTH = 120
"""Least characters of a line of a wide table, wherever it goes."""


def table(*headings: str, left: int = 1, title: str | None = None) -> Table:
    """A table without a frame; the first ``left`` columns hold text, the others numbers."""
    made = Table(box=None, pad_edge=False, title=title, show_header=any(headings))
    for index, heading in enumerate(headings):
        made.add_column(heading, justify="left" if index < left else "right")
    return made


def show(what: Table) -> None:
    """A table, as wide as the terminal."""
    Console(emoji=False).print(what)


def show_beside(headings: tuple[str, ...], *rows: tuple[str, ...]) -> None:
    """A table in as many parts, one below the other, as keep every cell on one line."""
    widths = [max(map(len, column)) + 2 for column in zip(headings, *rows, strict=True)]
    room, shown = Console().width + 2 - widths[0], 1  # no space after the last column
    while shown < len(headings):
        end = shown + 1
        while end < len(headings) and sum(widths[shown : end + 1]) <= room:
            end += 1
        part = table(*(headings[i] for i in (0, *range(shown, end))))
        for column in part.columns:
            column.no_wrap = True
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


def wide() -> Console:
    """Standard output for tables, with full column widths for terminals, files and pipes."""
    console = Console(soft_wrap=True, highlight=False, emoji=False)
    console.width = max(console.width, WIDTH)
    return console


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
    """Print an error as one line on standard error."""
    _print(Console(stderr=True), [f"error: {text}"], "red")


def json_line(**values: object) -> None:
    """Print one line of JSON on standard output, without buffering."""
    plain = sys.stdout is None or "utf" not in sys.stdout.encoding.lower()
    print(json.dumps(values, ensure_ascii=plain), flush=True)


def _print(console: Console, lines: list[str] | tuple[str, ...], style: str | None = None) -> None:
    for line in lines:
        console.print(line, style=style, soft_wrap=True, markup=False, highlight=False, emoji=False)
