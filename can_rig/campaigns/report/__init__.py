"""``report.html``, ``report.png`` and ``summary.json`` of a finished campaign."""

from can_rig.campaigns.report.write import write_report

__all__ = ["write_report"]
