"""The bench: the page that shows a run in a browser, live or recorded, without network.

uPlot draws the curves. A page is told its curves and charts by ``Curve`` and ``Chart``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Curve:
    """A signal as a line.

    Attributes:
        key: column of the data.
        label: name for a person.
        unit: in print; empty if dimensionless.
        colour: a colour of ``bench.css``.
        width: of the line, in pixels.
        dash: lengths of dashes and gaps, in pixels.
        stepped: hold each value until the next.
    """

    key: str
    label: str
    unit: str = ""
    colour: str = "ink"
    width: float = 1.4
    dash: tuple[int, ...] = ()
    stepped: bool = False


@dataclass(frozen=True)
class Chart:
    """Curves over one axis.

    Attributes:
        title: name for a person.
        keys: keys of the curves.
        scale: of the values: ``linear``, ``log`` or ``asinh``.
    """

    title: str
    keys: tuple[str, ...]
    scale: str = "linear"


@cache
def text(name: str) -> str:
    """The text of a file of this folder."""
    return (_HERE / name).read_text(encoding="utf-8")
