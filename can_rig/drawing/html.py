"""Common parts of the HTML pages: head, tables, a look that fits the pictures."""

from __future__ import annotations

import html
from collections.abc import Iterable
from typing import Any, Final

STYLE: Final = """
body { font-family: sans-serif; max-width: 60em; margin: 2em auto; color: #1b1b1b; }
table { border-collapse: collapse; margin: 1em 0; }
th, td { padding: 0.2em 0.8em 0.2em 0; text-align: left; vertical-align: top; }
th { border-bottom: 1px solid #1b1b1b; }
td.n { text-align: right; font-variant-numeric: tabular-nums; }
code { font-size: 85%; overflow-wrap: anywhere; }
img { max-width: 100%; }
"""


def page(title: str, parts: Iterable[str], style: str = "") -> str:
    """A whole page; ``parts`` are HTML, and ``style`` comes after the common one."""
    head = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(title)}</title><style>{STYLE}{style}</style></head><body>"
    )
    return "\n".join([head, *parts, "</body></html>\n"])


class Code(str):
    """Text set in code style."""

    __slots__ = ()


def table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table of texts and numbers."""

    def cell(value: Any) -> str:
        if isinstance(value, Code):
            return f"<td><code>{html.escape(value)}</code></td>"
        if isinstance(value, int | float) and not isinstance(value, bool):
            return f'<td class="n">{value:.6g}</td>'
        return f"<td>{html.escape(str(value))}</td>"

    headings = "".join(f"<th>{html.escape(text)}</th>" for text in head)
    lines = ("".join(cell(value) for value in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><tr>{headings}</tr>{body}</table>"
