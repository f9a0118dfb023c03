"""uPlot, which draws curves in a browser, as text to put into a page that opens without network."""

from __future__ import annotations

from functools import cache
from pathlib import Path

_HERE = Path(__file__).parent


@cache
def script() -> str:
    """Its script."""
    return (_HERE / "uPlot.iife.min.js").read_text(encoding="utf-8")


@cache
def style() -> str:
    """Its style sheet."""
    return (_HERE / "uPlot.min.css").read_text(encoding="utf-8")
