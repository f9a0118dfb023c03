"""The bench: the page that shows a run in a browser, live or recorded, without network.

uPlot draws the curves. A page is told its curves and charts by ``Curve`` and ``Chart``.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from can_rig import paged
from can_rig.drawing.thinning import extremes
from firmware_model.law.structs import FloatArray

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
        words: of a state, the word for each code.
        sets_scale: whether the axis reaches as far as this curve.
        beside: key of the same signal of a second run; empty without.
    """

    key: str
    label: str
    unit: str = ""
    colour: str = "ink"
    width: float = 1.4
    dash: tuple[int, ...] = ()
    stepped: bool = False
    words: Mapping[int, str] | None = None
    sets_scale: bool = True
    beside: str = ""


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


@dataclass
class Recording:
    """What the page of a recorded run shows.

    Attributes:
        time_s: (n,), ascending.
        curves: each curve and its values (n,); nan is a gap.
        charts: the charts at the beginning; further charts are added on the page.
        shades: times below the curves: begin and end in s (None: to the end), and a colour.
        marks: events: time in s and text.
        scene: the drawing of the plant; see ``results.motion``.
        height: of a chart, in pixels; 0: the charts share the height of the window.
        span_gaps: whether lines cross gaps: of signals with times of their own.
        frames: number and bytes of frames as ``decoding.trace`` packs them, their kinds, and a note
            where the page has not all frames; None: the page has no trace.
    """

    time_s: FloatArray
    curves: list[tuple[Curve, FloatArray]]
    charts: list[Chart]
    shades: list[dict[str, Any]] = field(default_factory=list)
    marks: list[dict[str, Any]] = field(default_factory=list)
    scene: dict[str, Any] | None = None
    height: int = 0
    span_gaps: bool = False
    frames: tuple[int, bytes, list[dict[str, Any]], str] | None = None


MOST_POINTS: Final = 100_000
"""Points of a curve; longer runs show the least and the greatest value of equal parts."""

SCRIPTS: Final = ("uPlot.iife.min.js", "charts.js", "trace.js", "scene.js", "recorded.js")


def style() -> str:
    """The style of every page of the bench."""
    return text("uPlot.min.css") + text("bench.css")


def recorded(of: Recording) -> Iterator[str]:
    """The parts of a page, in HTML, that show a recorded run; ``style`` belongs to the page."""
    yield '<canvas id="scene" hidden></canvas><div class="bar" id="play"></div>'
    trace = '<details id="trace"><summary>Frames</summary></details>' if of.frames else ""
    yield f'<div class="bar" id="bar"></div><div id="charts"></div>{trace}'
    yield '<h2>Events</h2><ol id="marks"></ol>'
    yield f'<script type="application/json" id="run">{_in_a_script(packed(of))}</script>'
    yield from (f"<script>{text(name)}</script>" for name in SCRIPTS)


def packed(of: Recording) -> dict[str, Any]:
    """A recording for JSON."""
    scene, first_s = None, float(of.time_s[0]) if len(of.time_s) else 0.0
    if of.scene is not None:
        columns = dict(of.scene["columns"])
        scene = {**of.scene, **_numbers(columns.pop("time"), columns)}
        del scene["columns"]
    frames = None
    if of.frames is not None:
        points, data, kinds, note = of.frames
        frames = {"points": points, "data": _deflated(data), "kinds": kinds, "note": note}
    begins = [shade["begin"] for shade in of.shades]
    return {
        "curves": [asdict(curve) for curve, _ in of.curves],
        "charts": [asdict(chart) for chart in of.charts],
        "shades": of.shades,
        "marks": of.marks,
        "scene": scene,
        "first": max(first_s, min(begins, default=first_s)),
        "height": of.height,
        "span_gaps": of.span_gaps,
        "frames": frames,
        **_numbers(*reduced(of.time_s, {curve.key: values for curve, values in of.curves})),
    }


def reduced(
    time_s: FloatArray, columns: Mapping[str, FloatArray]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """At most ``MOST_POINTS`` points of each column: the extremes of equal parts, in their order.

    The times are the times of the first tick and of the middle tick of each part.
    """
    ticks = -(-2 * len(time_s) // MOST_POINTS)
    if len(time_s) <= MOST_POINTS or not columns:
        return time_s, dict(columns)
    found: list[FloatArray] = []
    step = ticks * max(1, paged.BLOCK_ROWS // (ticks * (1 + len(columns))))
    for begin in range(0, len(time_s), step):
        rows = slice(begin, begin + step)
        block = np.stack([time_s[rows], *(values[rows] for values in columns.values())], axis=1)
        rest = -len(block) % ticks
        padded = np.pad(block, ((0, rest), (0, 0)), constant_values=np.nan)
        padded[len(block) :, 0] = block[-1, 0] + np.arange(1, rest + 1) * (time_s[1] - time_s[0])
        found.append(extremes(padded.reshape(-1, ticks, block.shape[1])).astype(np.float64))
        paged.let_go()
    whole = np.concatenate(found)
    return whole[:, 0], dict(zip(columns, whole[:, 1:].T, strict=True))


def _numbers(time_s: FloatArray, columns: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Deflated numbers for ``recorded.js``: the time as doubles, each column as floats."""
    parts: Sequence[bytes] = [
        time_s.astype("<f8").tobytes(),
        *(values.astype("<f4").tobytes() for values in columns.values()),
    ]
    return {"points": len(time_s), "keys": list(columns), "data": _deflated(b"".join(parts))}


def _deflated(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 1)).decode("ascii")


def _in_a_script(values: Mapping[str, Any]) -> str:
    """JSON that cannot end the surrounding element."""
    return json.dumps(values, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")


@cache
def text(name: str) -> str:
    """The text of a file of this folder."""
    return (_HERE / name).read_text(encoding="utf-8")
