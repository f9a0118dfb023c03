"""What ``can-rig plant`` and ``can-rig controller`` do, and what a person or ``run`` sees of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

from can_rig.errors import INTERRUPTED, LogError, RigError
from can_rig.nodes.progress import OnTick, Throttled, json_line
from can_rig.nodes.realtime import timing
from can_rig.nodes.runner import NodeSummary, run_controller, run_plant
from can_rig.nodes.watchdog import StopRequest, Timeouts
from can_rig.scenario import loading as scenarios
from can_rig.scenario.settings import Scenario


def plant_command(
    name: str,
    settings: Sequence[str],
    bus: str,
    log: Path | None,
    timeouts: Timeouts,
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
    with _node_output(scenario, as_json) as on_tick:
        summary = run_plant(
            scenario,
            bus,
            log,
            timeouts,
            stop,
            Throttled(on_tick),
            real_time=real_time,
            by_hand=True,
        )
    return _node_end(scenario, summary, as_json)


def controller_command(
    name: str,
    settings: Sequence[str],
    bus: str,
    timeouts: Timeouts,
    as_json: bool,
    real_time: bool,
) -> int:
    """``can-rig controller``: the exit status."""
    scenario = scenarios.load(name, settings)

    stop = StopRequest().on_signals()

    def on_ready() -> None:
        if as_json:
            json_line(ready=True)

    with _node_output(scenario, as_json) as on_tick:
        summary = run_controller(
            scenario,
            bus,
            timeouts,
            stop,
            on_ready,
            Throttled(on_tick),
            real_time=real_time,
            by_hand=True,
        )
    return _node_end(scenario, summary, as_json)


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
    console = Console(stderr=True)
    console.print(
        f"{summary.ticks} of {scenario.ticks} ticks, {summary.ticks_per_s:.0f} a second",
        highlight=False,
    )
    for label, text in timing.rows(summary.realtime or {}):
        console.print(f"{label}: {text}", highlight=False, soft_wrap=True)
    for line in timing.scheduling_lines(summary.realtime or {}):
        console.print(line, highlight=False, soft_wrap=True)
    return 0 if summary.ticks == scenario.ticks else INTERRUPTED
