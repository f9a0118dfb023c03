"""The differences of two runs on one page, in full and around the first difference."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from can_rig.drawing import style
from can_rig.drawing.thinning import thinned
from can_rig.views.run_diff import Difference, SignalDifference
from can_rig.views.signal_table import SignalTable, titles

BEFORE, AFTER = 15, 45  # rows around the first difference
MAX_SETTINGS: Final = 4  # in the heading; the table lists all settings
CURVES: Final[tuple[dict[str, Any], ...]] = (
    {"color": style.BLUE, "lw": 1.9},
    {"color": style.ORANGE, "lw": 1.2, "ls": style.DASHED},
)


def draw_difference(path: Path, a: SignalTable, b: SignalTable, difference: Difference) -> None:
    """Write ``difference_page`` in the format of the suffix."""
    difference_page(a, b, difference).savefig(path, dpi=150)


def difference_page(a: SignalTable, b: SignalTable, difference: Difference) -> Figure:
    """A row for each differing signal, or for all signals if none differs.

    The left panel shows the signal in full, the right panel the first difference. The runs are
    named by folder and scenario, with the settings that differ. The time in which ``b`` had a
    channel lost is shaded.
    """
    shown = [signal for signal in difference.signals if signal.beyond] or difference.signals
    figure = style.page(1.2 + 1.75 * max(len(shown), 1))
    axes = figure.subplots(len(shown), 2, squeeze=False, width_ratios=(3, 2), sharex="col")
    around = _around(a, difference)
    for (full, near), signal in zip(axes, shown, strict=True):
        _draw(full, a, b, signal, None)
        _draw(near, a, b, signal, around)
        full.set_ylabel(style.labelled(*a.name_and_unit(signal.signal)))
        near.yaxis.tick_right()
    for axis in axes[-1]:
        axis.set_xlabel("time in s")
    figure.legend(
        axes[0, 0].get_lines()[:2], titles(a, b),
        loc="outside upper center", ncols=2, frameon=False, fontsize=10,
        title=_settings(difference), title_fontsize=9,
    )  # fmt: skip
    first = difference.first_at_s
    where = "the end" if first is None else f"the first difference, {first:.6f} s"
    axes[0, 0].set_title("in full", fontsize=9, loc="left")
    axes[0, 1].set_title(f"around {where}", fontsize=9, loc="left")
    figure.align_ylabels(axes[:, 0])
    return figure


def _settings(difference: Difference) -> str | None:
    if not difference.settings:
        return None
    shown = [str(setting) for setting in difference.settings[:MAX_SETTINGS]]
    rest = len(difference.settings) - len(shown)
    return "\n".join(shown + [f"and {rest} more settings"] * bool(rest))


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
