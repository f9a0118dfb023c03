"""``report.html``, ``report.png`` and ``summary.json`` of a finished campaign."""

import base64
import html
import io
import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from textwrap import fill, shorten
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from can_rig.campaigns.execution import PAGE, PICTURE, SUMMARY, CampaignFolder
from can_rig.campaigns.plan import Plan
from can_rig.campaigns.requirements import Requirement
from can_rig.campaigns.rows import read_columns, requirements_of
from can_rig.campaigns.statistics import (
    Columns,
    Cross,
    CrossRow,
    Rate,
    Summary,
    columns_needed,
    least_so_far,
    margin_column,
    metrics_shown,
    numbers,
    percent,
    summarise,
)
from can_rig.drawing import style
from can_rig.drawing.html import Code, page, table
from can_rig.drawing.names import Names, in_words, metric_in_words, names_of
from can_rig.storage.files import atomic

MOST_METRICS: Final = 4
MOST_AXES: Final = 6
MOST_DOTS: Final = 4000
MOST_TEXT: Final = 110
"""Characters of a requirement in its bar."""
PANEL_IN, RATE_IN, WORD_IN = 1.9, 0.28, 0.14
"""Heights of a row of panels, of a requirement, and of a word beside a panel."""
FAR: Final = 10.0
"""The greatest value, in medians, from which on an axis is logarithmic."""
LINE: Final = 26
"""Characters of a label; longer labels would exceed the panel."""


def draw(plan: Plan, required: Sequence[Requirement], columns: Columns, summary: Summary) -> Figure:
    """The page; constant metrics are left out.

    After a search, the metrics come from the random runs only.
    """
    drawn = {name: values[plan.searched :] for name, values in columns.items()}
    metrics = [name for name in metrics_shown(required) if len({*drawn[name]} - {None}) > 1]
    metrics = metrics[:MOST_METRICS]
    axes = plan.settings.names[:MOST_AXES]
    heights = [PANEL_IN] * bool(summary.found)
    rated = any(rate.share is not None for rate in summary.rates)
    if rated:
        heights.append(RATE_IN * len(summary.rates) + 0.7)
    words = {key: words_of(drawn[key]) for key in axes}
    if metrics:
        heights += [PANEL_IN, *(PANEL_IN + WORD_IN * len(_beside(words[key])) for key in axes)]
    figure = style.page(0.8 + sum(heights))
    figure.suptitle(
        f"{style.plain(plan.settings.name)}: {summary.runs:,} runs of "
        f"{style.plain(', '.join(plan.bases))}, "
        f"{summary.hours:.3g} h",
        x=0.01, ha="left", fontsize=13,
    )  # fmt: skip
    if not heights:
        return figure
    rows = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)
    parts = iter(rows[:, 0])
    if summary.found:
        _found(next(parts).subplots(), plan, columns)
    if rated:
        _rates(next(parts).subplots(), summary)
    if not metrics:
        return figure
    names, failed = names_of(plan.base.scenario.plant), numbers(drawn["margin"]) < 0.0
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
            values, label = numbers(drawn[name]), label_of(name, names)
            _dots(axis, label_of_key(key), words[key], drawn[key], label, values, failed)
            its = plan.settings.axes.get(key)
            if its is not None and its.scale == "log" and not its.either_sign:
                axis.set_xscale("log")
            share = summary.sensitivities.get(name, {}).get(key)
            if share is not None:
                axis.set_title(f"{100.0 * share:.0f} % of the variance", fontsize=7, loc="right")
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
    axis.set_ylabel(f"least margin of\n{style.plain(plan.settings.search or '')}", fontsize=8)
    style.legend_above(axis)


def _rates(axis: Axes, summary: Summary) -> None:
    """A bar for each requirement, with its interval."""
    rates = [rate for rate in summary.rates if rate.share is not None][::-1]
    for at, rate in enumerate(rates):
        share, low, high = rate.share or 0.0, rate.low or 0.0, rate.high or 0.0
        axis.barh(at, 100.0, color=style.PALE_ORANGE, height=0.5)
        axis.barh(at, 100.0 * share, color=style.PALE_BLUE, height=0.5)
        axis.plot([100.0 * low, 100.0 * high], [at, at], color=style.INK, lw=2.0)
        text = f"{percent(share)}  ({percent(low)} to {percent(high)})"
        axis.text(101.5, at, text, fontsize=8, va="center")
        axis.text(0.8, at, shorten(_said(rate.text), MOST_TEXT), fontsize=6.5, va="center")
    axis.set_yticks(
        range(len(rates)), [style.plain(rate.name.replace("_", " ")) for rate in rates], fontsize=8
    )
    axis.tick_params(axis="y", length=0)
    axis.tick_params(axis="x", labelsize=7)
    axis.set_ylim(-0.5, len(rates) - 0.5)
    axis.set_xlim(0.0, 100.0)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.set_xlabel("runs that pass in %, with the 95 % interval", fontsize=8)


def _said(expression: str) -> str:
    """A requirement's expression with the metrics in words."""
    words = re.sub(r"[a-z]\w*", lambda name: in_words(name[0])[0], expression)
    return words.replace("<=", "≤").replace(">=", "≥").replace("==", "=")


def _histogram(axis: Axes, label: str, values: Any, failed: Any) -> None:
    """Counts on a logarithmic axis, so that a single run of the tail is seen."""
    known = np.isfinite(values)
    count, far = min(40, max(8, int(np.sqrt(known.sum())))), is_far_reaching(values)
    ends = np.nanmin(values[known]), np.nanmax(values[known])
    bins = (np.geomspace if far else np.linspace)(*ends, count + 1).tolist()
    for mask, colour, who in (
        (known, style.BLUE, "no requirement fails"),
        (known & failed, style.ORANGE, "a requirement fails"),
    ):
        axis.hist(values[mask], bins=bins, color=colour, label=who)
    for share, words in ((50.0, "median"), (99.0, "99 %")):
        at = float(np.percentile(values[known], share))
        axis.axvline(at, color=style.INK, lw=0.8, ls=style.DOTTED)
        axis.annotate(words, (at, 1.0), (0, 2), xycoords=("data", "axes fraction"),
                      textcoords="offset points", fontsize=6, ha="center")  # fmt: skip
    axis.set_xlabel(label, fontsize=7)
    axis.tick_params(labelsize=7, which="both")
    style.ruled(axis)
    if far:
        axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_ylim(bottom=0.7)
    axis.set_ylabel("runs", fontsize=7)


def is_far_reaching(values: Any) -> bool:
    """Whether the greatest value lies so far out that a linear axis would hide the others."""
    known = values[np.isfinite(values)]
    return bool(known.min() > 0.0 and known.max() > FAR * np.median(known))


def words_of(places: Sequence[Any]) -> list[str]:
    """The values of an axis that are no numbers, each once; empty for numbers."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in places):
        return []
    return sorted({str(value) for value in places})


def _beside(words: Sequence[str]) -> Sequence[str]:
    """The words that stand beside the panel, one below the other: too many to stand below it."""
    return words if len(" ".join(words)) > LINE else []


def _dots(
    axis: Axes, key: str, words: Sequence[str], places: Sequence[Any], label: str, values: Any,
    failed: Any,
) -> None:  # fmt: skip
    """A dot a run; values of an axis that are no numbers stand side by side, or in lines."""
    number = {word: float(at) for at, word in enumerate(words)}
    at = np.array([number[str(value)] for value in places]) if words else numbers(places)
    beside, some = bool(_beside(words)), slice(None, None, max(1, len(at) // MOST_DOTS))
    for mask, colour in ((~failed, style.BLUE), (failed, style.ORANGE)):
        pair = at[some][mask[some]], values[some][mask[some]]
        axis.plot(*pair[:: -1 if beside else 1], ".", color=colour, ms=2.5, alpha=0.5)
    along, across = (axis.yaxis, axis.xaxis) if beside else (axis.xaxis, axis.yaxis)
    along.set_label_text(key, fontsize=7)
    across.set_label_text(label, fontsize=7)
    if words:
        along.set_ticks(range(len(words)), [*map(style.plain, words)])
    if beside:
        axis.set_ylim(len(words) - 0.5, -0.5)
        axis.label_outer()
    if is_far_reaching(values):
        (axis.set_xscale if beside else axis.set_yscale)("log")
    axis.tick_params(labelsize=7, which="both")
    axis.grid(alpha=0.3, lw=0.5)


OF_FAULT: Final = {"at": "begin", "for": "duration", "left": "share left"}
"""Words for keys that are read with the name of their table."""


def label_of_key(key: str) -> str:
    """A key of a scenario in words, with the unit: ``plant: mass in kg``."""
    *tables, last = key.split(".")
    words, unit = in_words(last)
    place = " ".join(tables).replace("_", " ")
    words = style.in_a_line(OF_FAULT.get(words, words), unit)
    return fill(style.plain(f"{place}: {words}" if place else words), LINE)


def label_of(metric: str, names: Names) -> str:
    """A metric in words, with the names and units of the plant's own signals."""
    words, unit = metric_in_words(metric, names)
    return fill(f"{words} in {unit}" if unit else words, LINE)


PICTURE_DPI: Final = 110
MOST_REASONS: Final = 10


def html_page(plan: Plan, summary: Summary, figure: Figure) -> str:
    """The page as text."""
    settings = plan.settings
    picture = io.BytesIO()
    figure.savefig(picture, dpi=PICTURE_DPI, format="png")
    encoded = base64.b64encode(picture.getvalue()).decode("ascii")
    alarms = summary.false_alarms
    parts = [
        f"<h1>{html.escape(settings.name)}</h1><p>{html.escape(settings.description)}</p>",
        f"<p>{summary.runs:,} runs of <code>{html.escape(', '.join(plan.bases))}</code>, "
        f"{html.escape(settings.sampling)}, seed {settings.seed}; {summary.hours:.4g} h simulated; "
        f"{summary.failed:,} gave no result.</p>",
    ]
    if summary.found:
        parts += [f"<h2>Search: least margin of {html.escape(settings.search or '')}</h2>", table(
            ("method", "runs", "least margin", "failed", "first failed at run"),
            ((each.method, each.runs, *("-" if value is None else value for value in
              (each.least, each.failed, each.first_failed))) for each in summary.found),
        ), "<p>What follows is of the random runs, but for the worst ones.</p>"]  # fmt: skip
    if summary.rates:
        parts += ["<h2>Requirements</h2>", table(
            ("requirement", "expression", "passed", "failed", "without", "rate", "95 %"),
            ((rate.name, rate.text, rate.passed, rate.failed, rate.unknown, percent(rate.share),
              f"{percent(rate.low)} to {percent(rate.high)}") for rate in summary.rates),
        )]  # fmt: skip
    if alarms["per_hour"] is not None:
        parts.append(
            f"<p>{alarms['false_alarms']} false alarms in {alarms['hours']:.4g} h without a loss: "
            f"{alarms['per_hour']:.3g} an hour "
            f"(95 %: {alarms['low']:.3g} to {alarms['high']:.3g}).</p>"
        )
    parts += [
        "<h2>Metrics</h2>",
        table(
            ("metric", "runs", "least", "median", "99 %", "greatest"),
            ((each.name, each.runs, each.least, each.median, each.percentile_99, each.greatest)
             for each in summary.spreads),
        ),
        f'<img alt="pass rates, spread of the metrics, what each axis does to them" '
        f'src="data:image/png;base64,{encoded}">',
    ]  # fmt: skip
    parts += [part for each in summary.tables for part in _cross(each)]
    if settings.names:
        parts += ["<h2>What each axis explains</h2>",
                  "<p>Share of the variance that the axis explains alone.</p>", table(
            ("metric", *settings.names),
            ((name, *(percent(by[key]) for key in settings.names))
             for name, by in summary.sensitivities.items()),
        )]  # fmt: skip
    if summary.worst:
        parts += ["<h2>Worst runs</h2>", table(
            ("run", "margin", *settings.names, "again"),
            ((row["run"], row["margin"], *(row[key] for key in settings.names),
              Code(row["command"])) for row in summary.worst),
        )]  # fmt: skip
    if summary.reasons:
        parts += ["<h2>Runs without a result</h2>", table(
            ("runs", "reason"),
            ((n, reason) for reason, n in list(summary.reasons.items())[:MOST_REASONS]),
        )]  # fmt: skip
    return page(f"Campaign {settings.name}", parts)


def _cross(cross: Cross) -> list[str]:
    """A table with the runs of each column, how many fail, the worst, and the spreads."""
    requirements = [each.name for each in cross.rows[0].rates] if cross.rows else []
    metrics = list(dict.fromkeys(each.name for row in cross.rows for each in row.spreads))
    heads = (
        cross.of_rows, "runs", *cross.columns, *(f"fail {name}" for name in requirements),
        *(f"{name}: median, 99 %, greatest" for name in metrics),
    )  # fmt: skip
    lines = [
        (row.name, row.runs, *(row.counts.get(name, "") for name in cross.columns),
         *(_failed(each) for each in row.rates),
         *(_spread(row, name) for name in metrics))
        for row in cross.rows
    ]  # fmt: skip
    worst = [
        (row.name, name, its.run,
         ", ".join(f"{key} = {value}" for key, value in its.values.items()), Code(its.command))
        for row in cross.rows
        for name, its in row.worst.items()
    ]  # fmt: skip
    parts = [f"<h2>Table {html.escape(cross.name)}</h2>", table(heads, lines)]
    if worst:
        parts.append(table((cross.of_rows, "fails worst", "run", "with", "again"), worst))
    return parts


def _failed(rate: Rate) -> str:
    if not rate.failed:
        return "-" if rate.share is None else ""
    low, high = 1.0 - (rate.high or 0.0), 1.0 - (rate.low or 0.0)
    return f"{rate.failed} ({low:.1%} to {high:.1%})"


def _spread(row: CrossRow, name: str) -> str:
    its = next((each for each in row.spreads if each.name == name), None)
    return "" if its is None else f"{its.median:.3g}, {its.percentile_99:.3g}, {its.greatest:.3g}"


def write_report(folder: CampaignFolder) -> Summary:
    """Write the three files; returns the summary.

    Raises:
        LogError: a file cannot be written.
    """
    plan, required = folder.plan, requirements_of(folder.plan)
    columns = read_columns(folder.table, columns_needed(plan, required))
    summary = summarise(plan, required, columns)
    with atomic(folder.path / SUMMARY, force=True) as part:
        text = json.dumps(asdict(summary), indent=2, ensure_ascii=False, allow_nan=False)
        part.write_text(text + "\n", encoding="utf-8")
    figure = draw(plan, required, columns, summary)
    with atomic(folder.path / PICTURE, force=True) as part:
        figure.savefig(part, dpi=PICTURE_DPI, format="png")
    with atomic(folder.path / PAGE, force=True) as part:
        part.write_text(html_page(plan, summary, figure), encoding="utf-8")
    return summary
