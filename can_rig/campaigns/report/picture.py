"""``report.png``: pass rates with their intervals, spreads of metrics, the effect of each axis."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.requirements import Requirement
from can_rig.campaigns.statistics import (
    Columns,
    Summary,
    least_so_far,
    margin_column,
    metrics_shown,
    numbers,
)
from can_rig.drawing import style
from can_rig.drawing.names import CAR, Names, names_of

MOST_METRICS: Final = 4
MOST_AXES: Final = 6
MOST_DOTS: Final = 4000
PANEL_IN, RATE_IN = 1.9, 0.26
"""Heights of a row of panels, and of a requirement."""
LINE: Final = 24
"""Characters of a label; longer labels would exceed the panel."""


def draw(plan: Plan, required: Sequence[Requirement], columns: Columns, summary: Summary) -> Figure:
    """The page; constant metrics are left out.

    After a search, the metrics come from the random runs only.
    """
    drawn = {name: values[plan.searched :] for name, values in columns.items()}
    metrics = [name for name in metrics_shown(required) if len({*drawn[name]} - {None}) > 1]
    metrics = metrics[:MOST_METRICS]
    axes = list(plan.settings.axes)[:MOST_AXES]
    heights = [PANEL_IN] * bool(summary.found)
    if summary.rates:
        heights.append(RATE_IN * len(summary.rates) + 0.7)
    heights += [PANEL_IN] * (1 + len(axes)) if metrics else []
    figure = style.page(0.8 + sum(heights))
    figure.suptitle(
        f"{plan.settings.name}: {summary.runs:,} runs of {plan.base.name}, {summary.hours:.3g} h",
        x=0.01, ha="left", fontsize=13,
    )  # fmt: skip
    if not heights:
        return figure
    rows = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)
    parts = iter(rows[:, 0])
    if summary.found:
        _found(next(parts).subplots(), plan, columns)
    if summary.rates:
        _rates(next(parts).subplots(), summary)
    if not metrics:
        return figure
    names, failed = names_of(plan.base.plant), numbers(drawn["margin"]) < 0.0
    part = next(parts)
    panels = np.atleast_1d(part.subplots(1, len(metrics)))
    for axis, name in zip(panels, metrics, strict=True):
        _histogram(axis, label_of(name, names), numbers(drawn[name]), failed)
    part.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside upper right", ncols=2, frameon=False, fontsize=8,
    )  # fmt: skip
    for key in axes:
        panels = np.atleast_1d(next(parts).subplots(1, len(metrics)))
        for axis, name in zip(panels, metrics, strict=True):
            _dots(axis, key, drawn[key], label_of(name, names), numbers(drawn[name]), failed)
            if plan.settings.axes[key].scale == "log":
                axis.set_xscale("log")
            share = summary.sensitivities.get(name, {}).get(key)
            if share is not None:
                axis.set_title(f"explains {share:.0%}", fontsize=8, loc="right")
    return figure


def _found(axis: Axes, plan: Plan, columns: Columns) -> None:
    """The least margin so far, by the search and by random runs."""
    margins, searched = columns[margin_column(plan)], plan.searched
    for look, label, some in (
        (style.SERIES[1], "search", margins[:searched]),
        (style.SERIES[0], "random", margins[searched:]),
    ):
        least = least_so_far(some)
        axis.step(np.arange(1, len(least) + 1), least, where="post", label=label, **look)
    axis.axhline(0.0, color=style.INK, lw=0.8)
    style.ruled(axis)
    axis.set_xlabel("runs", fontsize=8)
    axis.set_ylabel(f"least margin of\n{plan.settings.search}", fontsize=8)
    style.legend_above(axis)


def _rates(axis: Axes, summary: Summary) -> None:
    """A bar for each requirement, with its interval."""
    rates = [rate for rate in summary.rates if rate.share is not None][::-1]
    for at, rate in enumerate(rates):
        share, low, high = rate.share or 0.0, rate.low or 0.0, rate.high or 0.0
        axis.barh(at, 100.0, color=style.PALE_ORANGE, height=0.5)
        axis.barh(at, 100.0 * share, color=style.PALE_BLUE, height=0.5)
        axis.plot([100.0 * low, 100.0 * high], [at, at], color=style.INK, lw=2.0)
        text = f"{100.0 * share:.4g} %  ({100.0 * low:.4g} to {100.0 * high:.4g})"
        axis.text(101.5, at, text, fontsize=8, va="center")
    axis.set_yticks(range(len(rates)), [rate.name.replace("_", " ") for rate in rates], fontsize=8)
    axis.tick_params(axis="y", length=0)
    axis.tick_params(axis="x", labelsize=7)
    axis.set_ylim(-0.5, len(rates) - 0.5)
    axis.set_xlim(0.0, 100.0)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.set_xlabel("runs that pass in %, with the 95 % interval", fontsize=8)


def _histogram(axis: Axes, label: str, values: Any, failed: Any) -> None:
    known = np.isfinite(values)
    bins = np.histogram_bin_edges(values[known], bins=min(40, max(5, int(np.sqrt(known.sum())))))
    axis.hist(
        [values[known & ~failed], values[known & failed]],
        bins=bins.tolist(),
        stacked=True,
        color=[style.BLUE, style.ORANGE],
        label=["all requirements hold", "one does not"],
    )
    axis.set_xlabel(label, fontsize=7)
    axis.tick_params(labelsize=7)
    style.ruled(axis)
    axis.set_ylim(bottom=0.0)
    axis.set_ylabel("runs", fontsize=7)


def _dots(
    axis: Axes, key: str, places: Sequence[Any], label: str, values: Any, failed: Any
) -> None:
    """A dot a run; values of an axis that are no numbers stand side by side."""
    texts = [str(value) for value in places]
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in places):
        at = numbers(places)
    else:
        distinct = sorted(set(texts))
        at = np.array([float(distinct.index(text)) for text in texts])
        axis.set_xticks(range(len(distinct)), distinct, fontsize=7)
    some = slice(None, None, max(1, len(at) // MOST_DOTS))
    for mask, colour in ((~failed, style.BLUE), (failed, style.ORANGE)):
        x, y = at[some][mask[some]], values[some][mask[some]]
        axis.plot(x, y, ".", color=colour, ms=2.5, alpha=0.5)
    axis.set_xlabel(key, fontsize=7)
    axis.set_ylabel(label, fontsize=6)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3, lw=0.5)


def label_of(metric: str, names: Names) -> str:
    """A metric in words, with the names and units of the plant's own signals."""
    output, command_1, command_2 = names
    integral = "m/s" if output.unit == CAR.output.unit else f"{output.unit} s".strip()
    units = {
        "_mps2": output.unit, "_mps": integral, "_nm": command_1.unit, "_s": "s",
        "_n": command_2.unit,
    }  # fmt: skip
    stem, unit = metric.replace("_per_hour", "_an_hour"), ""
    for suffix, of in units.items():
        if stem.endswith(suffix):
            stem, unit = stem.removesuffix(suffix), of
            break
    words = stem.replace("_", " ")
    for signal, own in (("torque", command_1), ("force difference", command_2), ("dstar", output)):
        words = words.replace(signal, own.name if own not in CAR else signal)
    return fill(f"{words} in {unit}" if unit else words, LINE)
