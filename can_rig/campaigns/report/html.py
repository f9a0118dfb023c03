"""``report.html``: one file with everything in it, for whoever has no Python."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable
from typing import Any, Final

from matplotlib.figure import Figure

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.statistics import Summary

PICTURE_DPI: Final = 110
MOST_REASONS: Final = 10

HEAD: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font-family: sans-serif; max-width: 60em; margin: 2em auto; color: #1b1b1b; }}
table {{ border-collapse: collapse; margin: 1em 0; }}
th, td {{ padding: 0.2em 0.8em 0.2em 0; text-align: left; vertical-align: top; }}
th {{ border-bottom: 1px solid #1b1b1b; }}
td.n {{ text-align: right; font-variant-numeric: tabular-nums; }}
code {{ font-size: 85%; overflow-wrap: anywhere; }}
img {{ max-width: 100%; }}
</style></head><body>
"""


def html_page(plan: Plan, summary: Summary, figure: Figure) -> str:
    """The page as text."""
    settings = plan.settings
    picture = io.BytesIO()
    figure.savefig(picture, dpi=PICTURE_DPI, format="png")
    encoded = base64.b64encode(picture.getvalue()).decode("ascii")
    alarms = summary.false_alarms
    parts = [
        HEAD.format(title=html.escape(f"Campaign {settings.name}")),
        f"<h1>{html.escape(settings.name)}</h1><p>{html.escape(settings.description)}</p>",
        f"<p>{summary.runs:,} runs of <code>{html.escape(plan.file.given)}</code>, "
        f"{html.escape(settings.sampling)}, seed {settings.seed}; {summary.hours:.4g} h simulated; "
        f"{summary.failed:,} gave no result.</p>",
    ]
    if summary.found:
        parts += [f"<h2>Search: least margin of {html.escape(settings.search or '')}</h2>", _table(
            ("", "runs", "least margin", "failed", "first failed at run"),
            ((each.method, each.runs, each.least, each.failed, each.first_failed)
             for each in summary.found),
        ), "<p>What follows is of the random runs, but for the worst ones.</p>"]  # fmt: skip
    if summary.rates:
        parts += ["<h2>Requirements</h2>", _table(
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
        _table(
            ("", "runs", "least", "median", "99 %", "greatest"),
            ((each.name, each.runs, each.least, each.median, each.percentile_99, each.greatest)
             for each in summary.spreads),
        ),
        f'<img alt="pass rates, spread of the metrics, what each axis does to them" '
        f'src="data:image/png;base64,{encoded}">',
    ]  # fmt: skip
    if settings.axes:
        parts += ["<h2>What each axis explains</h2>",
                  "<p>Share of the variance that the axis explains alone.</p>", _table(
            ("", *settings.axes),
            ((name, *(_percent(by[key]) for key in settings.axes))
             for name, by in summary.sensitivities.items()),
        )]  # fmt: skip
    if summary.worst:
        parts += ["<h2>Worst runs</h2>", _table(
            ("run", "margin", *settings.axes, "again"),
            ((row["run"], row["margin"], *(row[key] for key in settings.axes),
              _Code(row["command"])) for row in summary.worst),
        )]  # fmt: skip
    if summary.reasons:
        parts += ["<h2>Runs without a result</h2>", _table(
            ("runs", "reason"),
            ((n, reason) for reason, n in list(summary.reasons.items())[:MOST_REASONS]),
        )]  # fmt: skip
    return "\n".join([*parts, "</body></html>\n"])


class _Code(str):
    """Text that is set as code."""

    __slots__ = ()


def _table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    def cell(value: Any) -> str:
        if isinstance(value, _Code):
            return f"<td><code>{html.escape(value)}</code></td>"
        if isinstance(value, int | float) and not isinstance(value, bool):
            return f'<td class="n">{value:.6g}</td>'
        return f"<td>{'-' if value is None else html.escape(str(value))}</td>"

    headings = "".join(f"<th>{html.escape(text)}</th>" for text in head)
    lines = ("".join(cell(value) for value in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><tr>{headings}</tr>{body}</table>"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{share:.2%}"
