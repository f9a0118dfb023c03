"""Signals of a log on one page: a panel for each unit, words for signals with value tables."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from can_rig import paged
from can_rig.decoding.message_columns import MessageColumns
from can_rig.drawing import style
from can_rig.drawing.names import printed
from can_rig.drawing.thinning import thinned
from can_rig.logs.frames import NS_PER_S
from can_rig.scenario.settings import Scenario
from firmware_model.target.structs import FloatArray

FIRST_DATE_NS: Final = 10**9 * NS_PER_S
"""From here on a time stamp is a date, counted since 1970."""

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
        scenario: the times of its faults and disturbances are shaded.
    """
    panels: dict[tuple[str, str], list[Pair]] = {}
    for message, signal in signals:
        layout = messages[message].layout[signal]
        key = ("words", f"{message}.{signal}") if layout.is_enumeration else ("unit", layout.unit)
        panels.setdefault(key, []).append((message, signal))
    heights = [1.0 if kind == "words" else 1.6 for kind, _ in panels]
    figure = style.page(0.8 + 1.45 * sum(heights))
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=heights)
    axes = [row[0] for row in grid]
    dated = start_ns >= FIRST_DATE_NS
    for axis, ((kind, unit), pairs) in zip(axes, panels.items(), strict=True):
        for at, (message, signal) in enumerate(pairs):
            columns = messages[message]
            time_s, values = curve(columns, signal, start_ns if dated else 0)
            axis.step(
                *thinned(time_s, values),
                where="post",
                label=signal,
                **style.SERIES[at % len(style.SERIES)],
            )
        style.ruled(axis)
        if kind == "words":
            _words(axis, messages[pairs[0][0]], pairs[0][1])
        _name(axis, [signal for _, signal in pairs], unit if kind == "unit" else "")
    for axis in axes if not dated else ():
        style.shade_all(axis, scenario)
    axes[-1].set_xlabel(_time_label(start_ns) if dated else "time in s")
    figure.align_ylabels(axes)
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


def _words(axis: Axes, columns: MessageColumns, signal: str) -> None:
    """The words of the value table that occur, beside their codes."""
    codes = np.ma.getdata(columns.codes[signal])[~np.ma.getmaskarray(columns.codes[signal])]
    choices = columns.layout[signal].choices
    used = np.unique(codes).tolist()
    axis.set_yticks(used, [f"{choices.get(int(code), '?')} ({code})" for code in used])
    axis.set_ylim(min(used) - 0.4, max(used) + 0.4)


def _name(axis: Axes, names: Sequence[str], unit: str) -> None:
    if len(names) == 1:
        axis.set_ylabel(style.labelled(names[0], unit))
        return
    axis.set_ylabel(f"in {printed(unit)}" if unit else "")
    style.legend_above(axis)


def _time_label(start_ns: int) -> str:
    start = datetime.datetime.fromtimestamp(start_ns // NS_PER_S, datetime.UTC)
    return f"time in s since {start:%Y-%m-%d %H:%M:%S} UTC"
