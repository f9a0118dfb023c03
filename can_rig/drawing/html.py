"""Common parts of the HTML pages: head, tables, a look that fits the pictures."""

import html
from collections.abc import Iterable
from itertools import zip_longest
from typing import Any, Final

from can_rig.drawing import bench

STYLE: Final = """
main { max-width: 75rem; margin: 1rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: .5rem 0; }
th, td { padding: .15rem .8rem .15rem 0; text-align: left; vertical-align: top; }
th { border-bottom: 1px solid var(--soft); }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
code { font-size: 85%; color: var(--soft); overflow-wrap: anywhere; }
h1 { font-size: 1.3rem; } h2 { font-size: 1.05rem; }
p { margin: .2rem 0; }
img { max-width: 100%; }
"""


def page(title: str, parts: Iterable[str], style: str = "") -> str:
    """A whole page; ``parts`` are HTML, and ``style`` comes after the style of the bench."""
    head = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{bench.style()}{STYLE}{style}</style></head>"
        "<body><main>"
    )
    return "\n".join([head, *parts, "</main></body></html>\n"])


class Code(str):
    """Text set in code style."""

    __slots__ = ()


def table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table of texts and numbers; a heading stands as the first row's value does."""

    def is_number(value: Any) -> bool:
        return isinstance(value, int | float) and not isinstance(value, bool)

    def cell(value: Any) -> str:
        if isinstance(value, Code):
            return f"<td><code>{html.escape(value)}</code></td>"
        if is_number(value):
            return f'<td class="n">{value:.6g}</td>'
        return f"<td>{html.escape(str(value))}</td>"

    rows = [tuple(row) for row in rows]
    headings = "".join(
        f"<th{' class=n' if is_number(first) else ''}>{html.escape(text)}</th>"
        for text, first in zip_longest(head, rows[0] if rows else ())
        if text is not None
    )
    lines = ("".join(cell(value) for value in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><tr>{headings}</tr>{body}</table>"
