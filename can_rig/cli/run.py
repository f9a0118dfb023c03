"""``can-rig run``: refuse a bad scenario, run both nodes, leave a complete folder."""

import math
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import click

from can_rig.cli.options import (
    bus_option,
    controller_option,
    interaction_of,
    interaction_options,
    json_option,
    realtime_option,
    scenario_options,
    silence_option,
)
from can_rig.cli.output import counting, json_line, say, show_pairs
from can_rig.controllers.making import controller_of
from can_rig.errors import INTERRUPTED
from can_rig.logs.reading import read_log
from can_rig.logs.writing import refuse_log, write_log
from can_rig.nodes.bus_access import StopRequest, Timeouts
from can_rig.nodes.interaction import UNTOUCHED, Interaction
from can_rig.nodes.realtime import timing
from can_rig.results import execution
from can_rig.results.execution import INTERRUPTED_RUN, Options, refuse, refuse_from_outside
from can_rig.results.isolation import verdict_rows
from can_rig.results.metrics import Metrics, fault_rows, rows
from can_rig.results.run_folder import Outcome, log_of
from can_rig.scenario.driving import notes_of_drive
from can_rig.scenario.loading import load
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
    say(*scenario.notes, *notes_of_drive(scenario))
    say(*timing.scheduling_lines(outcome.realtime or {}))
    if outcome.outcome == INTERRUPTED_RUN:
        say(f"stopped after {outcome.ticks} of {scenario.ticks} ticks; these are in the run folder")
    say(f"run folder  {folder}")


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
    help="Also write the log to this file after the run, however the run ended: FILE.blf, .asc, "
    ".mf4, .trc, .csv, .log or .log.gz.  Repeatable.",
)
@click.option(
    "--in-process",
    is_flag=True,
    help="Run both nodes in this process: the same log, and without --bus much faster.",
)
@click.option("--allow-unstable", is_flag=True, help="Run a loop that `can-rig check` refuses.")
@click.option(
    "--no-report",
    is_flag=True,
    envvar="CAN_RIG_NO_REPORT",
    show_envvar=True,
    help="Draw no report.png and no report.html, which takes longer than a short run.",
)
@silence_option("1.0")
@controller_option
@json_option("The metrics and the outcome as one JSON object.")
@realtime_option
@interaction_options
def command(
    scenario: str,
    settings: tuple[str, ...],
    bus: str | None,
    out: Path | None,
    force: bool,
    logs: tuple[Path, ...],
    in_process: bool,
    allow_unstable: bool,
    no_report: bool,
    silence_s: float | None,
    controller: str,
    as_json: bool,
    real_time: bool,
    pace: float | None,
    injectable: bool,
) -> None:
    """Run both nodes through SCENARIO and write the run folder.

    Default: lockstep, exact and identical on every run. --realtime: the wall clock.
    """
    if in_process and real_time:
        raise click.UsageError("--in-process and --realtime: real time needs two processes")
    if in_process and silence_s is not None:
        raise click.UsageError("--in-process and --silence: in one process no node waits")
    interaction = interaction_of(pace, injectable, real_time)
    if in_process and interaction != UNTOUCHED:
        raise click.UsageError("--in-process and --pace or --injectable: two processes are needed")
    chosen = load(scenario, settings)
    stop = StopRequest()
    if chosen.own_code and not in_process:
        refuse_from_outside(chosen, allow_unstable, stop.on_signals())
    else:
        refuse(chosen, allow_unstable)
    for path in logs:
        refuse_log(path, force)
    running = controller_of(controller, chosen)
    runner = execution.in_process if in_process else execution.two_processes
    options = Options(
        force=force,
        bus=bus,
        runner=runner,
        real_time=real_time,
        progress=lambda: counting(chosen.name, "ticks", chosen.ticks),
        controller=running,
        timeouts=_timeouts(silence_s, interaction, chosen.tick_s),
        interaction=interaction,
        report=not no_report,
    )
    done = None if stop.wanted else execution.execute(chosen, out, stop.on_signals(), options)
    if done is None:
        say("stopped before the first tick; no run folder is left")
        sys.exit(INTERRUPTED)
    if as_json:
        json_line(folder=str(done.folder), metrics=done.metrics, **asdict(done.outcome))
    else:
        closing_table(done.happened, done.metrics, done.outcome, done.folder)
    for path in dict.fromkeys(logs):
        write_log(read_log(log_of(done.folder)), path, force=force)
    if done.failure is not None:
        raise done.failure
    sys.exit(done.exit_status)


def _timeouts(silence_s: float | None, interaction: Interaction, tick_s: float) -> Timeouts:
    """Unlimited silence for a run with pauses: the partner of a paused node hears no frame."""
    if silence_s is not None:
        return Timeouts(silence_s=silence_s)
    if interaction.injectable:
        return Timeouts(silence_s=math.inf)
    waits_s = tick_s / interaction.pace if interaction.pace else 0.0
    return Timeouts(silence_s=Timeouts.silence_s + waits_s)
