"""Figs. 2.2-2.4, 3.5 and 3.6 of the thesis: the sampled firmware over the continuous solution.

Or the like of Figs. 2.2-2.4 for a scenario.

The upper panel of each figure shows what the thesis prints: the continuous solution wide and pale,
the firmware thin and dark on top of it. The lower one shows the difference of the two.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from can_rig.drawing import style
from can_rig.drawing.names import ticks_text, with_unit
from can_rig.storage import files
from can_rig.thesis.comparisons import MAKERS, START_S, Comparison, Curve

LOOKS: tuple[dict[str, Any], ...] = (
    {"color": style.INK, "lw": 1.6, "ls": "-"},
    {"color": style.ORANGE, "lw": 1.3, "ls": (0, (5, 5))},
)
"""Of the first and the second curve, which are seen in turn where they coincide."""
MAX_MARKERS = 50  # largest number of samples with a marker each
LEGEND: dict[str, Any] = {"frameon": False, "fontsize": 9, "handlelength": 3.2}


def draw_figures(folder: Path, comparisons: Sequence[Comparison], force: bool) -> None:
    """Write ``fig-2.2.png`` and the other figures to ``folder``, for print.

    Raises:
        LogError: a figure exists without ``force``, or cannot be written.
    """
    refuse_existing(folder, force, [comparison.figure for comparison in comparisons])
    for comparison in comparisons:
        with files.atomic(folder / f"fig-{comparison.figure}.png", force=force) as part:
            _draw(part, comparison)


def refuse_existing(folder: Path, force: bool, names: Iterable[str] = MAKERS) -> None:
    """Refuse a folder with an existing figure, unless ``force`` is set.

    Raises:
        LogError: names the first existing figure.
    """
    for figure in names:
        path = folder / f"fig-{figure}.png"
        files.refuse_existing(path, force, "--out", new_folder=True)


def _draw(path: Path, comparison: Comparison) -> None:
    zoomed = comparison.figure.startswith("3.")
    figure = style.page(7.4 if zoomed else 5.0, style.COLUMN_WIDTH_IN)
    scenario = comparison.scenario
    everything = (0.0, float(scenario.ticks * scenario.tick_s))
    if zoomed:
        # The whole run as the thesis shows it, of its own car; the start and the loss enlarged.
        grid = figure.add_gridspec(3, 2, height_ratios=(1.0, 1.1, 0.9))
        places = [(0.0, START_S), (scenario.loss.at_s - 0.1, scenario.loss.at_s + 0.9)]
        whole = figure.add_subplot(grid[0, :])
        _signals(whole, comparison, everything, comparison.curves[:1])
        for column, place in enumerate(places):
            upper = figure.add_subplot(grid[1, column])
            _signals(upper, comparison, place, comparison.curves)
            upper.set_title(("the start", "the loss")[column], fontsize=9)
            _differences(figure.add_subplot(grid[2, column], sharex=upper), comparison, place)
            if column == 0:
                handles, labels = upper.get_legend_handles_labels()
        whole.set_xlabel("time in s", fontsize=9)
        figure.legend(handles, labels, loc="outside lower center", ncols=3, **LEGEND)
    else:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1.0))
        _signals(upper, comparison, everything, comparison.curves)
        _differences(lower, comparison, everything)
        figure.legend(
            *upper.get_legend_handles_labels(), loc="outside lower center", ncols=4, **LEGEND
        )
    figure.suptitle(
        f"{_whose(comparison)}: {comparison.caption}\n"
        f"tick {scenario.tick_s * 1e3:g} ms, latency {ticks_text(scenario.latency_ticks)}, "
        f"estimator {scenario.design.estimator}{_apart(comparison)}",
        fontsize=10,
    )
    figure.savefig(path, dpi=300)


def _signals(
    axis: Axes, comparison: Comparison, place: tuple[float, float], curves: Sequence[Curve]
) -> None:
    """The curves within ``place``, sampled on continuous."""
    inside = _inside(comparison, place)
    time_s = comparison.time_s[inside]
    label: str | None = "continuous"
    for curve in curves:
        if place == (0.0, START_S) and comparison.start is not None:
            axis.plot(*comparison.start, color=style.PALE_BLUE, lw=4.0, label=label)
        else:
            axis.plot(time_s, curve.continuous[inside], color=style.PALE_BLUE, lw=4.0, label=label)
        label = None
    marker = "o" if len(time_s) <= MAX_MARKERS else None
    for curve, look, size in zip(curves, LOOKS, (4.5, 2.0), strict=False):
        label = f"{_math(curve.name)}, sampled"
        axis.plot(time_s, curve.sampled[inside], marker=marker, ms=size, label=label, **look)
    symbols = dict.fromkeys(_math(curve.name.partition(",")[0]) for curve in curves)
    unit = f" in {comparison.unit}" if comparison.unit else ""
    axis.set_ylabel(f"{', '.join(symbols)}{unit}", fontsize=9)
    _finish(axis, comparison, place)


def _differences(axis: Axes, comparison: Comparison, place: tuple[float, float]) -> None:
    inside = _inside(comparison, place)
    for curve, look in zip(comparison.curves, LOOKS, strict=False):
        axis.plot(comparison.time_s[inside], curve.difference[inside], **look)
    unit = f"\nin {comparison.unit}" if comparison.unit else ""
    axis.set_ylabel(f"sampled − continuous{unit}", fontsize=9)
    axis.set_xlabel("time in s", fontsize=9)
    _finish(axis, comparison, place)


def _finish(axis: Axes, comparison: Comparison, place: tuple[float, float]) -> None:
    formatter = ScalarFormatter(useMathText=True)
    formatter.set_powerlimits((-2, 3))
    axis.yaxis.set_major_formatter(formatter)
    axis.tick_params(labelsize=8)
    axis.yaxis.get_offset_text().set_fontsize(8)
    axis.grid(alpha=0.35, lw=0.5)
    axis.set_xlim(place)
    style.shade_all(axis, comparison.scenario)


def _inside(comparison: Comparison, place: tuple[float, float]) -> NDArray[np.bool_]:
    return (comparison.time_s >= place[0]) & (comparison.time_s <= place[1])


def _apart(comparison: Comparison) -> str:
    """How far two sampled curves are apart, as a line."""
    if len(comparison.curves) != len(LOOKS):
        return ""
    first, second = comparison.curves
    most = float(np.nanmax(np.abs(first.sampled - second.sampled)))
    names = f"{_math(first.name)} and {_math(second.name)}"
    return f"\n{names} differ by {with_unit(f'{most:.1e}', comparison.unit)} at most"


def _whose(comparison: Comparison) -> str:
    """A figure of the thesis by its number, of a scenario by its name."""
    if comparison.figure in MAKERS:
        return f"Fig. {comparison.figure}"
    return style.plain(comparison.scenario.name)


def _math(name: str) -> str:
    """A curve's name as mathematics."""
    symbol, comma, rest = name.partition(",")
    shown = re.sub(r"([GNu])(\d)", r"\1_\2", symbol).replace("d̂", r"\hat d")
    return f"${shown}${comma}{rest}"
