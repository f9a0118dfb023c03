"""What ``can-rig run`` does: refuse what cannot run, run it, leave a complete folder."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from can_rig.assessment.stability import refuse_unstable
from can_rig.buses.bus import in_one_process
from can_rig.cli.node_commands import tick_progress
from can_rig.errors import INTERRUPTED, BusError, RigError
from can_rig.frames.messages import Network
from can_rig.logs.reading import read_log
from can_rig.logs.writing import refuse_log, write_log
from can_rig.nodes.lockstep import StopRequest
from can_rig.nodes.nodes import EveryNowAndThen, run_in_process
from can_rig.nodes.processes import run_processes
from can_rig.nodes.realtime import deadlines
from can_rig.plant.simulated import SimulatedPlant
from can_rig.results.metrics import Metrics, rows
from can_rig.results.run_folder import LOG, Outcome, create, finish, give_up
from can_rig.scenario import loading as scenarios
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.reference import on_the_bus
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
    if real_time:
        deadlines.require_causal(scenario)
    bus = _bus_name(bus, in_process)
    network = network_of(scenario)
    controller_table(scenario, network)  # what cannot run is refused before it starts
    on_the_bus(scenario, network)
    SimulatedPlant(scenario)
    if not allow_unstable:
        refuse_unstable(scenario)
    for path in logs:
        refuse_log(path, force)
    stop = StopRequest().on_signals()
    folder = create(out, scenario, force)
    outcome = Outcome(bus, realtime={} if real_time else None)
    failure: RigError | None = None
    start = time.perf_counter()
    try:
        with tick_progress(scenario) as on_tick:
            if in_process:
                summary = run_in_process(
                    scenario, bus, folder / LOG, stop, EveryNowAndThen(on_tick)
                )
            else:
                arguments = [name, *(a for s in settings for a in ("--set", s)), "--bus", bus]
                summary = run_processes(arguments, folder / LOG, stop, on_tick, real_time)
        outcome.ticks, outcome.wall_s = summary.ticks, summary.wall_s
        outcome.rejected_frames, outcome.realtime = summary.rejected_frames, summary.realtime
        outcome.bus_events = summary.bus_events
        if summary.ticks < scenario.ticks:
            outcome.outcome = "interrupted"
    except RigError as error:
        failure = error
        outcome.outcome, outcome.wall_s = str(error), time.perf_counter() - start
    if not (folder / LOG).is_file():
        give_up(folder)
        if failure is not None:
            raise failure
        return INTERRUPTED
    values = _finish(folder, scenario, network, outcome, failure)
    closing_table(scenario, network, values, outcome, folder)
    for path in logs:
        write_log(read_log(folder / LOG), path)
    if failure is not None:
        raise failure
    return INTERRUPTED if outcome.outcome == "interrupted" else 0


def _bus_name(bus: str | None, in_process: bool) -> str:
    """The bus of the run, refused before both nodes wait on it for each other in vain."""
    bus = bus or f"local:run-{os.getpid()}"
    if not in_process and in_one_process(bus):
        raise BusError(
            f"bus {bus!r}: stays within one process, and the nodes are two; --in-process, or the "
            "bus 'local', is right"
        )
    return bus


def _finish(
    folder: Path,
    scenario: Scenario,
    network: Network,
    outcome: Outcome,
    failure: RigError | None,
) -> Metrics:
    try:
        return finish(folder, scenario, network, outcome)
    except RigError:
        if failure is not None:  # came first, and may be why: a disk that was full already
            raise failure from None
        raise


def closing_table(
    scenario: Scenario, network: Network, values: Metrics, outcome: Outcome, folder: Path
) -> None:
    """Metrics, rate, frames not used and the folder of a run that has ended.

    No metrics and no rate where no command was recorded, and so no whole tick.
    """
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    if values.get("torque_peak_nm") is not None:
        for label, text in rows(values, network):
            table.add_row(label, text)
        factor = outcome.ticks_per_s * scenario.tick_s
        table.add_row("rate", f"{outcome.ticks_per_s:.0f} ticks/s, {factor:.1f} x real time")
    for label, text in deadlines.rows(outcome.realtime or {}):
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
    for line in deadlines.scheduling_lines(outcome.realtime or {}):
        console.print(line, soft_wrap=True, highlight=False)
    console.print(f"run folder  {folder}", soft_wrap=True, markup=False, highlight=False)
