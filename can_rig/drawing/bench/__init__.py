"""The bench: the page that shows a run in a browser, live or recorded, without network.

uPlot draws the curves. A page is told its curves and charts by ``Curve`` and ``Chart``.
"""

import base64
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from can_rig.storage import paged
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
_CURVES_AT_ONCE: Final = 20  # of the most points, in memory to see whether their times fit

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
    time_s, columns = of.time_s, {curve.key: values for curve, values in of.curves}
    if len(time_s) > MOST_POINTS:
        time_s, drawn = on_one_axis([(time_s, values) for values in columns.values()])
        columns = dict(zip(columns, drawn, strict=True))
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
        **_numbers(time_s, columns),
    }


def on_one_axis(
    curves: Sequence[tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, list[FloatArray]]:
    """Curves with times of their own at common times, without losing a peak.

    Every point is kept where the curves have few times, and no time twice. Otherwise the time is
    cut into equal parts. Each part has two times: the first has the least or the greatest value of
    a curve in the part, the second has the other; nan without a value.

    Args:
        curves: time and values of each, (n,) in any order, as a clock that is set back leaves
            them; n is at least one.
    """
    if not curves:
        return np.empty(0), []
    lengths = [len(time_s) for time_s, _ in curves]
    if max(lengths) <= MOST_POINTS and sum(lengths) <= _CURVES_AT_ONCE * MOST_POINTS:
        every = np.unique(np.concatenate([time_s for time_s, _ in curves]))
        told_apart = all(len(np.unique(time_s)) == len(time_s) for time_s, _ in curves)
        if len(every) <= MOST_POINTS and told_apart:
            return every, [at_times(every, *curve) for curve in curves]
    begin = min(float(time_s.min()) for time_s, _ in curves)
    end = max(float(time_s.max()) for time_s, _ in curves)
    parts = min(MOST_POINTS // 2, sum(lengths))
    width = (end - begin) / parts or 1.0
    columns = [_extremes(time_s, values, begin, width, parts) for time_s, values in curves]
    known = np.isfinite(np.stack(columns)).any(axis=0)
    times = begin + 0.5 * width * np.arange(2 * parts, dtype=np.float64)
    return times[known], [column[known] for column in columns]


def at_times(every_s: FloatArray, time_s: FloatArray, values: FloatArray) -> FloatArray:
    """The values at their times, which ``every_s`` (n,) contains; nan between."""
    column = np.full(len(every_s), np.nan)
    column[np.searchsorted(every_s, time_s)] = values
    return column


def _extremes(
    time_s: FloatArray, values: FloatArray, begin: float, width: float, parts: int
) -> FloatArray:
    """(2 parts,), the least and the greatest value of each part in the order of the curve."""
    least, greatest, first, last = np.full((4, parts), np.nan)
    count = np.zeros(parts, dtype=np.int64)
    for rows in paged.blocks(len(time_s)):
        part = np.minimum(((time_s[rows] - begin) / width).astype(np.int64), parts - 1)
        some = values[rows]
        if (part[1:] < part[:-1]).any():
            order = np.argsort(part, kind="stable")
            part, some = part[order], some[order]
        starts = np.flatnonzero(np.diff(part, prepend=-1))
        ends, at = np.append(starts[1:], len(part)), part[starts]
        least[at] = np.fmin(least[at], np.fmin.reduceat(some, starts))
        greatest[at] = np.fmax(greatest[at], np.fmax.reduceat(some, starts))
        first[at] = np.where(count[at] == 0, some[starts], first[at])
        last[at] = some[ends - 1]
        count[at] += ends - starts
    rising = first <= last
    both = np.stack([np.where(rising, least, greatest), np.where(rising, greatest, least)], axis=1)
    both[count < 2, 1] = np.nan
    return both.ravel()


def _numbers(time_s: FloatArray, columns: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Deflated numbers for ``recorded.js``: the time as doubles, each column as floats."""
    with np.errstate(over="ignore"):  # a value beyond a float is infinite there
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
