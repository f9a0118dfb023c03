"""What the commands of ``can-rig`` do, and what a person sees of it."""

from __future__ import annotations

import os
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from can_rig import scenario as scenarios
from can_rig.build import controller_table
from can_rig.check import check, refuse_unstable, table_rows
from can_rig.cli import INTERRUPTED
from can_rig.errors import LogError, RigError
from can_rig.lockstep import StopRequest, Waiting
from can_rig.logs.reading import read_log
from can_rig.logs.writing import refuse_log, write_log
from can_rig.messages import Network
from can_rig.metrics import Metrics, rows
from can_rig.nodes import (
    EveryNowAndThen,
    NodeSummary,
    json_line,
    network_of,
    run_controller,
    run_in_process,
    run_plant,
)
from can_rig.plant import SimulatedPlant
from can_rig.realtime import deadlines
from can_rig.realtime import nodes as realtime_nodes
from can_rig.reference import on_the_bus
from can_rig.run import run_processes
from can_rig.run_folder import LOG, Outcome, create, finish, give_up
from can_rig.settings import Scenario

OnTick = Callable[[int], None]


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
    bus = bus or f"local:run-{os.getpid()}"
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
    values = finish(folder, scenario, network, outcome)
    closing_table(scenario, network, values, outcome, folder)
    for path in logs:
        write_log(read_log(folder / LOG), path)
    if failure is not None:
        raise failure
    return INTERRUPTED if outcome.outcome == "interrupted" else 0


def plant_command(
    name: str,
    settings: Sequence[str],
    bus: str,
    log: Path | None,
    waiting: Waiting,
    as_json: bool,
    real_time: bool,
) -> int:
    """``can-rig plant``: the exit status."""
    if log is not None and log.suffix.lower() in {".asc", ".blf", ".trc", ".mf4", ".gz"}:
        raise LogError(
            f"{log}: a node records candump lines as it goes, .log is right; "
            "can-rig run --log writes other formats"
        )
    scenario = scenarios.load(name, settings)
    stop = StopRequest().on_signals()
    run_node = realtime_nodes.run_plant if real_time else run_plant
    with _node_output(scenario, as_json) as on_tick:
        summary = run_node(scenario, bus, log, waiting, stop, EveryNowAndThen(on_tick))
    return _node_end(scenario, summary, as_json)


def controller_command(
    name: str,
    settings: Sequence[str],
    bus: str,
    waiting: Waiting,
    as_json: bool,
    real_time: bool,
) -> int:
    """``can-rig controller``: the exit status."""
    scenario = scenarios.load(name, settings)

    stop = StopRequest().on_signals()

    def on_ready() -> None:
        if as_json:
            json_line(ready=True)

    run_node = realtime_nodes.run_controller if real_time else run_controller
    with _node_output(scenario, as_json) as on_tick:
        summary = run_node(scenario, bus, waiting, stop, on_ready, EveryNowAndThen(on_tick))
    return _node_end(scenario, summary, as_json)


def check_command(name: str, settings: Sequence[str], as_json: bool) -> int:
    """``can-rig check``: the exit status, 0 for a stable loop and 1 for one that is not."""
    result = check(scenarios.load(name, settings))
    if as_json:
        json_line(**result.as_dict())
        return 0 if result.stable else 1
    headings, *rows_of_figures = table_rows(result)
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left")
    for row in rows_of_figures:
        table.add_row(*row)
    console = Console()
    console.print(table)
    for note in result.notes:
        console.print(note, markup=False, highlight=False)
    console.print(result.verdict, soft_wrap=True, markup=False, highlight=False)
    return 0 if result.stable else 1


def scenarios_command() -> None:
    """``can-rig scenarios``."""
    table = Table("scenario", "what it shows", box=None, pad_edge=False)
    for name, path in scenarios.shipped().items():
        table.add_row(name, tomllib.loads(path.read_text(encoding="utf-8"))["description"])
    Console().print(table)


def figures_command(settings: Sequence[str], out: Path, force: bool) -> None:
    """``can-rig figures``: draw them, and say how far the firmware is from the continuous loop."""
    from can_rig.thesis import figures  # noqa: PLC0415 (matplotlib and python-control: slow to import)
    from can_rig.thesis.comparisons import compare  # noqa: PLC0415

    figures.refuse_existing(out, force)
    comparisons = compare(settings)
    table = Table(title="largest distance, sampled - continuous", box=None, pad_edge=False)
    for heading in ("figure", "signal", "whole run", "of its size", "after the loss", "tick"):
        table.add_column(heading, justify="left" if heading in {"figure", "signal"} else "right")
    for comparison in comparisons:
        tick = f"{comparison.scenario.tick_s * 1e3:g} ms"
        for curve in comparison.curves:
            distance, after = comparison.distance(curve), comparison.distance_after_loss(curve)
            table.add_row(
                comparison.figure,
                curve.name,
                f"{distance:.2e} {comparison.unit}".rstrip(),
                f"{distance / comparison.size:.1e}",
                "" if after is None else f"{after:.2e} {comparison.unit}".rstrip(),
                tick,
            )
    figures.draw_figures(out, comparisons, force)
    Console().print(table)
    Console().print(f"figures in {out}", highlight=False)


@contextmanager
def tick_progress(scenario: Scenario) -> Iterator[OnTick]:
    """A bar on standard error, with ticks done and time left."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("ticks"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(scenario.name, total=scenario.ticks)
        yield lambda tick: bar.update(task, completed=tick)


@contextmanager
def _node_output(scenario: Scenario, as_json: bool) -> Iterator[OnTick]:
    """Progress of one node: a bar for a person, JSON lines for ``can-rig run``."""
    if not as_json:
        with tick_progress(scenario) as on_tick:
            yield on_tick
        return
    try:
        yield lambda tick: json_line(ticks=tick)
    except RigError as error:
        json_line(error=str(error))
        raise SystemExit(error.exit_status) from None


def _node_end(scenario: Scenario, summary: NodeSummary, as_json: bool) -> int:
    if as_json:
        json_line(**asdict(summary))
        return 0
    rate = summary.ticks / summary.wall_s if summary.wall_s else 0.0
    console = Console(stderr=True)
    console.print(
        f"{summary.ticks} of {scenario.ticks} ticks, {rate:.0f} a second", highlight=False
    )
    for label, text in deadlines.rows(summary.realtime or {}):
        console.print(f"{label}: {text}", highlight=False, soft_wrap=True)
    for line in deadlines.scheduling_lines(summary.realtime or {}):
        console.print(line, highlight=False, soft_wrap=True)
    return 0 if summary.ticks == scenario.ticks else INTERRUPTED


def closing_table(
    scenario: Scenario, network: Network, values: Metrics, outcome: Outcome, folder: Path
) -> None:
    """Metrics, rate, frames not used and the folder of a run that has ended."""
    units = {
        "y": network.feedback.unit,
        "y.s": f"{network.feedback.unit}.s".lstrip("."),
        "u1": network.command_1.unit,
        "u2": network.command_2.unit,
    }
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    for label, text in rows(values, units):
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
    console.print(table)
    for line in deadlines.scheduling_lines(outcome.realtime or {}):
        console.print(line, soft_wrap=True, highlight=False)
    console.print(f"run folder  {folder}", soft_wrap=True, markup=False, highlight=False)
