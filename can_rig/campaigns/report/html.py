"""``report.html``: a single self-contained file, readable without Python."""

from __future__ import annotations

import base64
import html
import io
from typing import Final

from matplotlib.figure import Figure

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.statistics import Summary
from can_rig.drawing.html import Code, page, table

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
        f"<p>{summary.runs:,} runs of <code>{html.escape(plan.file.given)}</code>, "
        f"{html.escape(settings.sampling)}, seed {settings.seed}; {summary.hours:.4g} h simulated; "
        f"{summary.failed:,} gave no result.</p>",
    ]
    if summary.found:
        parts += [f"<h2>Search: least margin of {html.escape(settings.search or '')}</h2>", table(
            ("", "runs", "least margin", "failed", "first failed at run"),
            ((each.method, each.runs, *("-" if value is None else value for value in
              (each.least, each.failed, each.first_failed))) for each in summary.found),
        ), "<p>What follows is of the random runs, but for the worst ones.</p>"]  # fmt: skip
    if summary.rates:
        parts += ["<h2>Requirements</h2>", table(
            ("", "expression", "passed", "failed", "without", "rate", "95 %"),
            ((rate.name, rate.text, rate.passed, rate.failed, rate.unknown, _percent(rate.share),
              f"{_percent(rate.low)} to {_percent(rate.high)}") for rate in summary.rates),
        )]  # fmt: skip
    if alarms["per_hour"] is not None:
        parts.append(
            f"<p>{alarms['false_alarms']} false alarms: {alarms['per_hour']:.3g} an hour "
            f"(95 %: {alarms['low']:.3g} to {alarms['high']:.3g}).</p>"
        )
    parts += [
        "<h2>Metrics</h2>",
        table(
            ("", "runs", "least", "median", "99 %", "greatest"),
            ((each.name, each.runs, each.least, each.median, each.percentile_99, each.greatest)
             for each in summary.spreads),
        ),
        f'<img alt="pass rates, spread of the metrics, what each axis does to them" '
        f'src="data:image/png;base64,{encoded}">',
    ]  # fmt: skip
    if settings.axes:
        parts += ["<h2>What each axis explains</h2>",
                  "<p>Share of the variance that the axis explains alone.</p>", table(
            ("", *settings.axes),
            ((name, *(_percent(by[key]) for key in settings.axes))
             for name, by in summary.sensitivities.items()),
        )]  # fmt: skip
    if summary.worst:
        parts += ["<h2>Worst runs</h2>", table(
            ("run", "margin", *settings.axes, "again"),
            ((row["run"], row["margin"], *(row[key] for key in settings.axes),
              Code(row["command"])) for row in summary.worst),
        )]  # fmt: skip
    if summary.reasons:
        parts += ["<h2>Runs without a result</h2>", table(
            ("runs", "reason"),
            ((n, reason) for reason, n in list(summary.reasons.items())[:MOST_REASONS]),
        )]  # fmt: skip
    return page(f"Campaign {settings.name}", parts)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{share:.2%}"
