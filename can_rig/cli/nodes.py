"""``can-rig plant`` and ``can-rig controller``: one node each."""

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import click

from can_rig.cli.options import (
    Function,
    above_zero,
    bus_of_processes,
    bus_option,
    controller_option,
    force_option,
    interaction_of,
    interaction_options,
    json_option,
    realtime_option,
    scenario_options,
    silence_option,
)
from can_rig.cli.output import counting, json_line, tell
from can_rig.errors import INTERRUPTED, LogError, RigError
from can_rig.logs.reading import WRITTEN
from can_rig.nodes.bus_access import OnTick, StopRequest, Throttled, Timeouts
from can_rig.nodes.realtime import timing
from can_rig.nodes.recording import recorded_log
from can_rig.nodes.runner import RunOptions, run_controller, run_plant
from can_rig.nodes.ticks import NodeSummary
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario


def _node_options(function: Function) -> Function:
    """The options of both nodes, beyond SCENARIO and --set."""
    for decorate in (
        bus_option("local", "local", bus_of_processes),
        json_option("Progress and summary as JSON lines."),
        silence_option("1.0; plant --realtime drives on alone"),
        click.option(
            "--wait",
            "first_s",
            default=60.0,
            callback=above_zero,
            show_default=True,
            metavar="S",
            help="Seconds to wait for the other node to appear.",
        ),
        realtime_option,
    ):
        function = decorate(function)
    return function


@contextmanager
def _node_progress(scenario: Scenario, as_json: bool) -> Iterator[OnTick]:
    """Progress of one node: a bar for a person, JSON lines for a program."""
    if not as_json:
        with counting(scenario.name, "ticks", scenario.ticks) as on_tick:
            yield on_tick
        return
    try:
        yield lambda tick: json_line(ticks=tick)
    except RigError as error:
        json_line(error=str(error))
        raise SystemExit(error.exit_status) from None


def _end_of_node(scenario: Scenario, summary: NodeSummary, as_json: bool) -> int:
    """Say how it went: the exit status."""
    if as_json:
        json_line(**asdict(summary))
        return 0
    tell(f"{summary.ticks} of {scenario.ticks} ticks, {summary.ticks_per_s:.0f} a second")
    realtime = summary.realtime or {}
    tell(*(f"{label}: {text}" for label, text in timing.rows(realtime)))
    tell(*timing.scheduling_lines(realtime))
    return 0 if summary.ticks == scenario.ticks else INTERRUPTED


@click.command("plant")
@scenario_options
@_node_options
@click.option(
    "--log", type=click.Path(path_type=Path, dir_okay=False), help="Record candump lines here."
)
@interaction_options
@force_option
def plant(
    scenario: str,
    settings: tuple[str, ...],
    bus: str,
    log: Path | None,
    silence_s: float | None,
    first_s: float,
    as_json: bool,
    real_time: bool,
    pace: float | None,
    injectable: bool,
    force: bool,
) -> None:
    """Run the plant node: the simulated car, in lockstep with a controller node or in real time.

    In real time the plant node survives the controller node: actuators hold, then drop to zero.
    """
    if log is not None and log.suffix.lower() in {*WRITTEN, ".gz"} - {".log"}:
        raise LogError(
            f"{log}: must be FILE.log, a node records candump lines as it goes; "
            "can-rig run --log writes other formats"
        )
    interaction = interaction_of(pace, injectable, real_time)
    alone_s = math.inf if real_time else Timeouts.silence_s
    timeouts = Timeouts(first_s, alone_s if silence_s is None else silence_s)
    chosen = load(scenario, settings)
    stop = StopRequest().on_signals()
    with recorded_log(log, force) as recording, _node_progress(chosen, as_json) as on_tick:
        summary = run_plant(
            chosen,
            bus,
            recording.path,
            stop,
            recording.before(Throttled(on_tick)),
            RunOptions(real_time, by_hand=True, timeouts=timeouts, interaction=interaction),
        )
        on_tick(summary.ticks)
    sys.exit(_end_of_node(chosen, summary, as_json))


@click.command("controller")
@scenario_options
@_node_options
@controller_option
def controller_node(
    scenario: str,
    settings: tuple[str, ...],
    bus: str,
    silence_s: float | None,
    first_s: float,
    as_json: bool,
    real_time: bool,
    controller: str,
) -> None:
    """Run the controller node: the firmware, in lockstep with a plant node or in real time.

    In real time a controller may start, or restart, while the car drives: the controller listens
    for 50 ms, then takes over without a bump.
    """
    from can_rig.controllers.making import controller_of  # noqa: PLC0415 (a plant needs none)

    timeouts = Timeouts(first_s, Timeouts.silence_s if silence_s is None else silence_s)
    chosen = load(scenario, settings)
    running = controller_of(controller, chosen)
    stop = StopRequest().on_signals()

    def on_ready() -> None:
        if as_json:
            json_line(ready=True)

    with _node_progress(chosen, as_json) as on_tick:
        summary = run_controller(
            chosen,
            bus,
            stop,
            on_ready,
            Throttled(on_tick),
            RunOptions(real_time, by_hand=True, timeouts=timeouts, controller=running),
        )
        on_tick(summary.ticks)
    sys.exit(_end_of_node(chosen, summary, as_json))
