"""What ``can-rig run`` does: refuse what cannot run, run it, leave a complete folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from can_rig.cli.node_commands import tick_progress
from can_rig.errors import INTERRUPTED
from can_rig.frames.messages import Network
from can_rig.logs.reading import read_log
from can_rig.logs.writing import refuse_log, write_log
from can_rig.nodes.realtime import timing
from can_rig.nodes.watchdog import StopRequest
from can_rig.results import execution
from can_rig.results.execution import refuse
from can_rig.results.metrics import Metrics, rows
from can_rig.results.run_folder import LOG, Outcome
from can_rig.scenario import loading as scenarios
from can_rig.scenario.settings import Scenario


def run_command(
    name: str,
    settings: Sequence[str],
    bus: str | None,
    out: Path | None,
    force: bool,
    logs: Sequence[Path],
    in_process: bool,
    allow_unstable: bool,
    real_time: bool,
) -> int:
    """``can-rig run``: the exit status. Without a ``bus`` the run has a local one of its own."""
    scenario = scenarios.load(name, settings)
    refuse(scenario, allow_unstable)
    for path in logs:
        refuse_log(path, force)
    stop = StopRequest().on_signals()
    runner = execution.in_process if in_process else execution.two_processes
    done = execution.execute(
        scenario,
        out,
        stop,
        force=force,
        bus=bus,
        runner=execution.real_time if real_time else runner,
        progress=lambda: tick_progress(scenario),
    )
    if done is None:
        return INTERRUPTED
    closing_table(done.scenario, done.network, done.metrics, done.outcome, done.folder)
    for path in logs:
        write_log(read_log(done.folder / LOG), path)
    if done.failure is not None:
        raise done.failure
    return done.exit_status


def closing_table(
    scenario: Scenario, network: Network, values: Metrics, outcome: Outcome, folder: Path
) -> None:
    """Metrics, rate, frames not used and the folder of a run that has ended.

    No metrics and no rate where no command was recorded, and so no whole tick.
    """
    units = {
        "y": network.feedback.unit,
        "y.s": f"{network.feedback.unit}.s".lstrip("."),
        "u1": network.command_1.unit,
        "u2": network.command_2.unit,
    }
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    if values.get("torque_peak_nm") is not None:
        for label, text in rows(values, units):
            table.add_row(label, text)
        factor = outcome.ticks_per_s * scenario.tick_s
        table.add_row("rate", f"{outcome.ticks_per_s:.0f} ticks/s, {factor:.1f} x real time")
    for label, text in timing.rows(outcome.realtime or {}):
        table.add_row(label, text)
    rejected: Counter[str] = Counter()
    for counts in outcome.rejected_frames.values():
        rejected.update(counts)
    if rejected:
        table.add_row("frames not used", ", ".join(f"{n} {k}" for k, n in rejected.items()))
    for node, events in outcome.bus_events.items():
        table.add_row(f"bus of the {node}", ", ".join(f"{n} {k}" for k, n in events.items()))
    console = Console()
    if table.row_count:
        console.print(table)
    for line in timing.scheduling_lines(outcome.realtime or {}):
        console.print(line, soft_wrap=True, highlight=False)
    console.print(f"run folder  {folder}", soft_wrap=True, markup=False, highlight=False)
