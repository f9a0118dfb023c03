"""Where two runs part, on one page: every signal that differs, whole and around the first place."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from can_rig.results.report import BLUE, INK, LOST, ORANGE
from can_rig.scenario.settings import FaultSettings
from can_rig.views.run_diff import Difference, SignalDifference
from can_rig.views.signal_table import SignalTable, unit

BEFORE, AFTER = 15, 45  # rows around the first difference


def draw_difference(
    path: Path,
    a: SignalTable,
    b: SignalTable,
    difference: Difference,
    labels: tuple[str, str],
    units: Mapping[str, str] | None = None,
) -> None:
    """Write ``difference_page`` as a PNG."""
    difference_page(a, b, difference, labels, units).savefig(path, dpi=150, format="png")


def difference_page(
    a: SignalTable,
    b: SignalTable,
    difference: Difference,
    labels: tuple[str, str],
    units: Mapping[str, str] | None = None,
) -> Figure:
    """One row a signal that differs (all, where none does): left the whole run, right the place.

    Times in which ``b`` had a channel lost are shaded.
    """
    shown = [signal for signal in difference.signals if signal.beyond] or difference.signals
    figure = Figure(figsize=(8.27, 1.0 + 1.75 * max(len(shown), 1)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(shown), 2, squeeze=False, width_ratios=(3, 2), sharex="col")
    around = _around(a, difference)
    for (whole, near), signal in zip(axes, shown, strict=True):
        _draw(whole, a, b, signal, None)
        _draw(near, a, b, signal, around)
        measure = (units or {}).get(signal.signal, unit(signal.signal))
        name = signal.signal.removesuffix(_suffix(signal.signal)).replace("_", " ")
        whole.set_ylabel(f"{name}\nin {measure}" if measure else name)
        near.yaxis.tick_right()
    for axis in axes[-1]:
        axis.set_xlabel("time in s")
    handles = axes[0, 0].get_lines()[:2]
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False, fontsize=10)
    first = difference.first_at_s
    axes[0, 0].set_title("whole", fontsize=9, loc="left")
    where = "the end" if first is None else f"the first difference, {first:.6f} s"
    axes[0, 1].set_title(f"around {where}", fontsize=9, loc="left")
    figure.align_ylabels(axes[:, 0])
    return figure


_SUFFIXES: Final = ("_mps2", "_nm", "_n")


def _suffix(name: str) -> str:
    return next((suffix for suffix in _SUFFIXES if name.endswith(suffix)), "")


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
    name = signal.signal
    for table, color, style, width in (
        (a, BLUE, "-", 1.9),
        (b, ORANGE, (0, (4, 2)), 1.2),
    ):
        rows = slice(None)
        if span_s is not None:
            first, last = np.searchsorted(table.time_s, span_s)
            rows = slice(int(first), int(last) + 1)
        axis.step(
            table.time_s[rows],
            table.columns[name][rows],
            where="post",
            color=color,
            ls=style,
            lw=width,
            marker="." if span_s is not None else "",
            ms=3,
        )
    axis.grid(alpha=0.3, lw=0.5)
    axis.margins(x=0.0, y=0.08)
    if signal.first_at_s is not None:
        axis.axvline(signal.first_at_s, color=INK, lw=0.8, ls=(0, (1, 2)))
    if span_s is not None:
        axis.set_xlim(*span_s)
    shade_loss(axis, b.fault)


def shade_loss(axis: Axes, fault: FaultSettings | None) -> None:
    """Shade the time of a fault, as far as the axis shows it."""
    if fault is None or fault.kind == "none":
        return
    low, high = axis.get_xlim()
    end_s = high if fault.for_s is None else fault.at_s + fault.for_s
    if fault.at_s < high and end_s > low:
        axis.axvspan(max(low, fault.at_s), min(high, end_s), color=LOST, lw=0, zorder=0)
