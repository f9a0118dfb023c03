"""``report.html``, ``report.png`` and ``summary.json`` of a campaign that is done."""

from can_rig.campaigns.report.write import write_report

__all__ = ["write_report"]
