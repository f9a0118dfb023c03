"""The last lines of a run: metrics, rate, unused frames, folder."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from can_rig.cli.output import say, show_pairs
from can_rig.nodes.realtime import timing
from can_rig.results.isolation import verdict_rows
from can_rig.results.metrics import Metrics, fault_rows, rows
from can_rig.results.run_folder import Outcome
from can_rig.scenario.settings import Scenario


def closing_table(scenario: Scenario, values: Metrics, outcome: Outcome, folder: Path) -> None:
    """Metrics, rate, unused frames and folder of a finished run.

    Without a recorded command no tick is complete, so the table has no metrics and no rate.
    """
    closing: list[tuple[str, str]] = []
    if values.get("torque_peak_nm") is not None:
        closing += rows(values, scenario.plant)
        closing += fault_rows(scenario, outcome.faults)
        closing += verdict_rows(scenario, outcome.whose_fault)
        factor = outcome.ticks_per_s * scenario.tick_s
        closing.append(("rate", f"{outcome.ticks_per_s:.0f} ticks/s, {factor:.1f} x real time"))
    closing += timing.rows(outcome.realtime or {})
    rejected: Counter[str] = Counter()
    for counts in outcome.rejected_frames.values():
        rejected.update(counts)
    if rejected:
        closing.append(("frames not used", ", ".join(f"{n} {k}" for k, n in rejected.items())))
    for node, events in outcome.bus_events.items():
        closing.append((f"bus of the {node}", ", ".join(f"{n} {k}" for k, n in events.items())))
    if closing:
        show_pairs(closing)
    say(*scenario.notes)
    say(*timing.scheduling_lines(outcome.realtime or {}))
    say(f"run folder  {folder}")
