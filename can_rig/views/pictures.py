"""The pictures of two compared runs, of a log's signals and of the bus load."""

import datetime
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from can_rig.decoding.message_decoder import MessageColumns
from can_rig.drawing import style
from can_rig.drawing.thinning import thinned
from can_rig.errors import LogError
from can_rig.logs.frames import NS_PER_S
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from can_rig.views.diff import Difference, SignalDifference
from can_rig.views.log_statistics import LogStatistics
from can_rig.views.signal_table import SignalTable, titles
from firmware_model.law.structs import FloatArray

BEFORE, AFTER = 15, 45  # rows around the first difference
MAX_SETTINGS: Final = 4  # in the heading; the table lists all settings
LEFT_IN, RIGHT_IN, BOTTOM_IN, ROW_IN, HEADING_IN, LINE_IN = 1.25, 0.75, 0.5, 1.75, 0.6, 0.17
"""Fixed margins: automatic margins would draw the page twice."""
CURVES: Final[tuple[dict[str, Any], ...]] = (
    {"color": style.BLUE, "lw": 1.9},
    {"color": style.ORANGE, "lw": 1.2, "ls": style.DASHED},
)


def difference_page(a: SignalTable, b: SignalTable, difference: Difference) -> Figure:
    """A row for each differing signal, or for all signals if none differs.

    The left panel shows the signal in full, the right panel the first difference. The runs are
    named by folder and scenario, with the settings that differ. The time in which ``b`` had a
    channel lost is shaded.
    """
    shown = [signal for signal in difference.signals if signal.beyond] or difference.signals
    settings = _settings(difference)
    figure, axes = _rows(len(shown), 0 if settings is None else 1 + settings.count("\n"))
    around = _around(a, difference)
    for (full, near), signal in zip(axes, shown, strict=True):
        _draw(full, a, b, signal, None)
        _draw(near, a, b, signal, around)
        name, unit = a.name_and_unit(signal.signal)
        full.set_ylabel(style.labelled(textwrap.fill(name, 22), unit), fontsize=9)
        near.yaxis.tick_right()
    for axis in axes[-1]:
        axis.set_xlabel("time in s")
    figure.legend(
        axes[0, 0].get_lines()[:2], [style.plain(each) for each in titles(a, b)],
        loc="upper center", ncols=2, frameon=False, fontsize=10, title=settings, title_fontsize=9,
    )  # fmt: skip
    first = difference.first_at_s
    where = "the end" if first is None else f"the first difference, {first:.6f} s"
    axes[0, 0].set_title("in full", fontsize=9, loc="left")
    axes[0, 1].set_title(f"around {where}", fontsize=9, loc="left")
    figure.align_ylabels(axes[:, 0])
    return figure


def _rows(panels: int, settings: int) -> tuple[Figure, Any]:
    """A page of so many rows of two panels, below so many settings."""
    heading_in = HEADING_IN + LINE_IN * settings
    height_in = heading_in + BOTTOM_IN + ROW_IN * max(panels, 1)
    figure = style.page(height_in, constrained=False)
    return figure, figure.subplots(
        panels, 2, squeeze=False, width_ratios=(3, 2), sharex="col",
        gridspec_kw={
            **style.margins(height_in, LEFT_IN, RIGHT_IN, heading_in, BOTTOM_IN),
            "wspace": 0.06, "hspace": 0.1,
        },
    )  # fmt: skip


def overlay(runs: Mapping[str, SignalTable], signals: Sequence[str]) -> Figure:
    """A panel for each signal, a curve for each run, by the runs' names.

    Raises:
        LogError: a signal that a run lacks.
    """
    figure = style.page(0.8 + 1.6 * len(signals))
    axes = figure.subplots(len(signals), 1, squeeze=False, sharex=True)[:, 0]
    for axis, signal in zip(axes, signals, strict=True):
        for at, (name, table) in enumerate(runs.items()):
            if signal not in table.columns:
                raise LogError(
                    f"{name}: has no signal {signal}; its signals are {', '.join(table.columns)}"
                )
            curve = thinned(table.time_s, table.columns[signal])
            axis.step(
                *curve,
                where="post",
                label=style.plain(name),
                **style.SERIES[at % len(style.SERIES)],
            )
            axis.set_ylabel(style.labelled(*table.name_and_unit(signal)))
        style.ruled(axis)
    style.legend_above(axes[0])
    axes[-1].set_xlabel("time in s")
    figure.align_ylabels(axes)
    return figure


def _settings(difference: Difference) -> str | None:
    if not difference.settings:
        return None
    shown = [str(setting) for setting in difference.settings[:MAX_SETTINGS]]
    rest = len(difference.settings) - len(shown)
    return style.plain("\n".join(shown + [f"and {rest} more settings"] * bool(rest)))


def _around(a: SignalTable, difference: Difference) -> tuple[float, float]:
    """The time about the first difference, s."""
    time_s = a.time_s
    first = difference.first_at_s
    at = len(time_s) - 1 if first is None else int(np.searchsorted(time_s, first))
    low, high = max(at - BEFORE, 0), min(at + AFTER, len(time_s) - 1)
    return float(time_s[low]), float(max(time_s[high], time_s[low] + 1e-9))


def _draw(
    axis: Axes,
    a: SignalTable,
    b: SignalTable,
    signal: SignalDifference,
    span_s: tuple[float, float] | None,
) -> None:
    for table, curve in zip((a, b), CURVES, strict=True):
        rows = slice(None)
        if span_s is not None:
            first, last = np.searchsorted(table.time_s, span_s)
            rows = slice(int(first), int(last) + 1)
        axis.step(
            *thinned(table.time_s[rows], table.columns[signal.signal][rows]),
            where="post",
            marker="." if span_s is not None else "",
            ms=3,
            **curve,
        )
    style.ruled(axis)
    if signal.first_at_s is not None:
        axis.axvline(signal.first_at_s, color=style.INK, lw=0.8, ls=style.DOTTED)
    if span_s is not None:
        axis.set_xlim(*span_s)
    style.shade_all(axis, b.scenario)


FIRST_DATE_NS: Final = 10**9 * NS_PER_S
"""From here on a time stamp is a date, counted since 1970."""

_WORD_HEIGHT: Final = 0.14
_MOST_HEIGHT: Final = 6.0
"""Heights of a word and of the highest panel of words, in parts of the lowest such panel."""

Pair = tuple[str, str]


def plot_page(
    messages: Mapping[str, MessageColumns],
    signals: Sequence[Pair],
    start_ns: int,
    scenario: Scenario | None = None,
) -> Figure:
    """The page.

    Args:
        messages: decoded columns by name.
        signals: message and signal of each curve.
        start_ns: when the recording began; if the start is a date, the axis counts from the date.
        scenario: the times of its faults and disturbances are shaded and named.
    """
    dated = start_ns >= FIRST_DATE_NS
    zero_ns = start_ns if dated else 0
    often = Counter(signal for _, signal in signals)
    panels: dict[tuple[str, str], list[Pair]] = {}
    for message, signal in signals:
        layout = messages[message].layout[signal]
        key = ("words", f"{message}.{signal}") if layout.is_enumeration else ("unit", layout.unit)
        panels.setdefault(key, []).append((message, signal))
    codes = {  # the codes in the data; a panel of words has one signal
        panel: np.unique(curve(messages[pairs[0][0]], pairs[0][1], zero_ns)[1])
        for panel, pairs in panels.items()
        if panel[0] == "words"
    }
    heights = [
        min(max(1.0, _WORD_HEIGHT * len(codes[panel])), _MOST_HEIGHT) if panel in codes else 1.6
        for panel in panels
    ]
    figure = style.page(0.8 + 1.45 * sum(heights))
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=heights)
    axes = [row[0] for row in grid]
    for axis, (panel, pairs) in zip(axes, panels.items(), strict=True):
        for at, (message, signal) in enumerate(pairs):
            time_s, values = curve(messages[message], signal, zero_ns)
            if panel in codes:  # evenly spaced: beside a far code such as 255 words would collide
                values = np.searchsorted(codes[panel], values).astype(np.float64)
            axis.step(
                *thinned(time_s, values),
                where="post",
                label=style.in_a_line(
                    signal if often[signal] == 1 else f"{message}.{signal}",
                    "" if panel in codes else panel[1] or "",
                ),
                **style.SERIES[at % len(style.SERIES)],
            )
        style.ruled(axis)
        axis.yaxis.get_offset_text().set_horizontalalignment("right")  # beside the legend
        if panel in codes:
            _words(axis, messages[message].layout[signal].choices, codes[panel])
        named = scenario is not None and axis is axes[0]
        style.legend_above(axis, "left", raised=0.12 if named else 0.0)
    if scenario is not None and not dated:
        style.mark_faults(axes, scenario)
    axes[-1].set_xlabel(_time_label(start_ns) if dated else "time in s")
    return figure


def curve(columns: MessageColumns, signal: str, zero_ns: int) -> tuple[FloatArray, FloatArray]:
    """Time in s after ``zero_ns`` and value, (n,) each, of the frames that have the signal.

    Of a signal whose values are words, the code.
    """
    enumeration = columns.layout[signal].is_enumeration
    column = columns.codes[signal] if enumeration else columns.signals[signal]
    time_ns, values = columns.time_ns, np.ma.getdata(column)
    if np.ma.is_masked(column):
        there = ~np.ma.getmaskarray(column)
        time_ns, values = time_ns[there], values[there]
    time_s = paged.column(
        len(time_ns), lambda rows: np.divide(time_ns[rows] - zero_ns, NS_PER_S, dtype=np.float64)
    )
    return time_s, values.astype(np.float64, copy=False)


def _words(axis: Axes, choices: Mapping[int, str], codes: FloatArray) -> None:
    """The words of the value table that occur, beside their codes; of too many, some."""
    every = -(-len(codes) * _WORD_HEIGHT // _MOST_HEIGHT)
    shown = np.arange(0, len(codes), max(int(every), 1))
    words = (f"{choices.get(int(code), '?')} ({code:.0f})" for code in codes[shown])
    axis.set_yticks(shown, [style.plain(word) for word in words])
    axis.set_ylim(-0.4, len(codes) - 0.6)


def _time_label(start_ns: int) -> str:
    start = datetime.datetime.fromtimestamp(start_ns // NS_PER_S, datetime.UTC)
    return f"time in s since {start:%Y-%m-%d %H:%M:%S} UTC"


def load_page(statistics: LogStatistics) -> Figure:
    """A panel for each bus: the upper bound of its busy share in each second."""
    buses = statistics.buses
    figure = style.page(0.8 + 1.6 * max(len(buses), 1))
    grid = figure.subplots(max(len(buses), 1), 1, sharex=True, squeeze=False)
    for (axis,), bus in zip(grid, buses, strict=False):
        second, share = statistics.load(bus)
        edges = np.stack([second, second, second + 1, second + 1], axis=1).ravel()
        begins = np.diff(second, prepend=-np.inf) > 1  # no frame in the second before
        ends = np.diff(second, append=np.inf) > 1
        first, last = np.where(begins, 0.0, share), np.where(ends, 0.0, share)
        heights = np.stack([first, share, share, last], axis=1).ravel()
        axis.plot(edges, 100 * heights, color=style.BLUE, lw=1.2)
        axis.set_ylabel(style.labelled(f"load of {bus}", "%"))
        axis.set_ylim(bottom=0.0)
        style.ruled(axis)
    grid[-1][0].set_xlabel("time since the first frame in s")
    return figure
