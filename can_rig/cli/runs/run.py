"""``can-rig run``: refuse what cannot run, run it, leave a complete folder."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import click

from can_rig.assessment.resolve import load
from can_rig.assessment.stability import refuse_unstable
from can_rig.buses.bus import in_one_process
from can_rig.cli.options import bus_option, realtime_option, scenario_options
from can_rig.cli.progress import counting
from can_rig.cli.runs.closing import closing_table
from can_rig.errors import INTERRUPTED, BusError, RigError
from can_rig.frames.network import Network
from can_rig.logs.reading import read_log
from can_rig.logs.writing import refuse_log, write_log
from can_rig.nodes.lockstep import StopRequest
from can_rig.nodes.nodes import EveryNowAndThen, run_in_process
from can_rig.nodes.processes import run_processes
from can_rig.nodes.realtime import deadlines
from can_rig.plant.simulated import SimulatedPlant
from can_rig.results.metrics import Metrics
from can_rig.results.run_folder import LOG, Outcome, create, finish, give_up
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.reference import on_the_bus
from can_rig.scenario.settings import Scenario


@click.command("run")
@scenario_options
@bus_option(None, "a local bus of its own")
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [runs/SCENARIO-TIME].")
@click.option("--force", is_flag=True, help="Replace the run folder if it exists.")
@click.option(
    "--log",
    "logs",
    multiple=True,
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write the log here too when the run has ended, however: FILE.blf, .asc, .mf4, .trc, "
    ".log or .log.gz.  Repeatable.",
)
@click.option("--in-process", is_flag=True, help="Both nodes in this process; the same log.")
@click.option("--allow-unstable", is_flag=True, help="Run a loop that `can-rig check` refuses.")
@realtime_option
def command(
    scenario: str,
    settings: tuple[str, ...],
    bus: str | None,
    out: Path | None,
    force: bool,
    logs: tuple[Path, ...],
    in_process: bool,
    allow_unstable: bool,
    real_time: bool,
) -> None:
    """Run both nodes through SCENARIO and collect the run folder.

    In lockstep, which is exact and the same on every run, or with --realtime by the wall clock.
    """
    if in_process and real_time:
        raise click.UsageError("--in-process and --realtime: real time needs two processes")
    chosen = load(scenario, settings)
    if real_time:
        deadlines.require_causal(chosen)
    bus = _bus_name(bus, in_process)
    network = network_of(chosen)
    controller_table(chosen, network)  # what cannot run is refused before it starts
    on_the_bus(chosen, network)
    SimulatedPlant(chosen)
    if not allow_unstable:
        refuse_unstable(chosen)
    for path in logs:
        refuse_log(path, force)
    stop = StopRequest().on_signals()
    folder = create(out, chosen, force)
    outcome = Outcome(bus, realtime={} if real_time else None)
    failure: RigError | None = None
    start = time.perf_counter()
    try:
        with counting(chosen.name, "ticks", chosen.ticks) as on_tick:
            if in_process:
                summary = run_in_process(chosen, bus, folder / LOG, stop, EveryNowAndThen(on_tick))
            else:
                arguments = [scenario, *(a for s in settings for a in ("--set", s)), "--bus", bus]
                summary = run_processes(arguments, folder / LOG, stop, on_tick, real_time)
            on_tick(summary.ticks)
        outcome.ticks, outcome.wall_s = summary.ticks, summary.wall_s
        outcome.rejected_frames, outcome.realtime = summary.rejected_frames, summary.realtime
        outcome.bus_events = summary.bus_events
        if summary.ticks < chosen.ticks:
            outcome.outcome = "interrupted"
    except RigError as error:
        failure = error
        outcome.outcome, outcome.wall_s = str(error), time.perf_counter() - start
    if not (folder / LOG).is_file():
        give_up(folder)
        if failure is not None:
            raise failure
        sys.exit(INTERRUPTED)
    values = _finish(folder, chosen, network, outcome, failure)
    closing_table(chosen, network, values, outcome, folder)
    for path in logs:
        write_log(read_log(folder / LOG), path)
    if failure is not None:
        raise failure
    sys.exit(INTERRUPTED if outcome.outcome == "interrupted" else 0)


def _bus_name(bus: str | None, in_process: bool) -> str:
    """The bus of the run, refused before both nodes wait on it for each other in vain."""
    bus = bus or f"local:run-{os.getpid()}"
    if not in_process and in_one_process(bus):
        raise BusError(
            f"bus {bus!r}: stays within one process, and the nodes are two; must be a bus between "
            "processes, such as local, or the run --in-process"
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
