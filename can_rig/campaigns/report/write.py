"""The files of a report, from the table."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Final

from can_rig.campaigns.campaign import PAGE, PICTURE, SUMMARY, CampaignFolder
from can_rig.campaigns.report.html import html_page
from can_rig.campaigns.report.picture import draw
from can_rig.campaigns.run import requirements_of
from can_rig.campaigns.statistics import Summary, margin_column, metrics_shown, summarise
from can_rig.campaigns.table import read_columns
from can_rig.files import atomic

PICTURE_DPI: Final = 110


def write_report(folder: CampaignFolder) -> Summary:
    """Write the three files; returns the summary.

    Raises:
        LogError: a file cannot be written.
    """
    plan, required = folder.plan, requirements_of(folder.plan)
    names = [
        "run", "simulated_s", "failure", "false_alarms", "margin", "command",
        *plan.settings.axes,
        *metrics_shown(required),
        *(f"passed.{each.name}" for each in required),
        margin_column(plan),
    ]  # fmt: skip
    columns = read_columns(folder.table, list(dict.fromkeys(names)))
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
