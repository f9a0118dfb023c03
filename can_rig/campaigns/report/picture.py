"""``report.png``: pass rates with their intervals, spreads of metrics, what each axis does."""

from __future__ import annotations

from collections.abc import Sequence
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

MOST_METRICS: Final = 4
MOST_AXES: Final = 6
MOST_DOTS: Final = 4000
PANEL_IN: Final = 2.3


def draw(plan: Plan, required: Sequence[Requirement], columns: Columns, summary: Summary) -> Figure:
    """The page; metrics that are the same in every run that has them are left out."""
    metrics = [name for name in metrics_shown(required) if len({*columns[name]} - {None}) > 1]
    metrics = metrics[:MOST_METRICS]
    axes = list(plan.settings.axes)[:MOST_AXES]
    rows = bool(summary.found) + bool(summary.rates) + (1 + len(axes) if metrics else 0)
    figure = style.page(1.0 + PANEL_IN * max(rows, 1))
    figure.suptitle(
        f"{plan.settings.name}: {summary.runs:,} runs of {plan.base.name}, {summary.hours:.3g} h",
        x=0.02, ha="left",
    )  # fmt: skip
    if not rows:
        return figure
    parts = iter(figure.subfigures(rows, 1, squeeze=False)[:, 0])
    if summary.found:
        _found(next(parts).subplots(), plan, columns)
    if summary.rates:
        _rates(next(parts).subplots(), summary)
    if not metrics:
        return figure
    failed = numbers(columns["margin"]) < 0.0
    panels = np.atleast_1d(next(parts).subplots(1, len(metrics)))
    for axis, name in zip(panels, metrics, strict=True):
        _histogram(axis, name, numbers(columns[name]), failed)
    for key in axes:
        panels = np.atleast_1d(next(parts).subplots(1, len(metrics)))
        for axis, name in zip(panels, metrics, strict=True):
            _dots(axis, key, columns[key], name, numbers(columns[name]), failed)
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
        axis.barh(at, 100.0, color=style.PALE_ORANGE, height=0.6)
        axis.barh(at, 100.0 * share, color=style.PALE_BLUE, height=0.6)
        axis.plot([100.0 * low, 100.0 * high], [at, at], color=style.INK, lw=2.0)
        axis.text(1.0, at + 0.36, f"{rate.name}: {share:.2%} ({low:.2%} to {high:.2%})", fontsize=8)
    axis.set_yticks([])
    axis.set_ylim(-0.5, len(rates) - 0.2)
    axis.set_xlim(0.0, 100.0)
    axis.set_xlabel("runs that pass in %, with the 95 % interval", fontsize=8)


def _histogram(axis: Axes, name: str, values: Any, failed: Any) -> None:
    known = np.isfinite(values)
    bins = np.histogram_bin_edges(values[known], bins=min(40, max(5, int(np.sqrt(known.sum())))))
    axis.hist(
        [values[known & ~failed], values[known & failed]],
        bins=bins.tolist(),
        stacked=True,
        color=[style.BLUE, style.ORANGE],
        label=["all requirements hold", "one does not"],
    )
    _name(axis, name)
    axis.set_ylabel("runs", fontsize=8)
    axis.legend(frameon=False, fontsize=7)


def _dots(axis: Axes, key: str, places: Sequence[Any], name: str, values: Any, failed: Any) -> None:
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
    axis.set_xlabel(key, fontsize=8)
    axis.set_ylabel(name.replace("_", " "), fontsize=6)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3, lw=0.5)


def _name(axis: Axes, name: str) -> None:
    axis.set_xlabel(name.replace("_", " "), fontsize=7)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3, lw=0.5)
