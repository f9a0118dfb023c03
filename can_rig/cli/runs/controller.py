"""``can-rig controller``."""

from __future__ import annotations

import sys

import click

from can_rig.assessment.resolve import load
from can_rig.cli.options import controller_option, scenario_options
from can_rig.cli.output import json_line
from can_rig.cli.runs.node import end_of_node, node_options, node_progress
from can_rig.export.controllers import controller_of
from can_rig.nodes.bus_access import StopRequest, Timeouts
from can_rig.nodes.clock import Throttled
from can_rig.nodes.runner import RunOptions, run_controller


@click.command("controller")
@scenario_options
@node_options
@controller_option
def command(
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
    timeouts = Timeouts(first_s, Timeouts.silence_s if silence_s is None else silence_s)
    chosen = load(scenario, settings)
    running = controller_of(controller, chosen)
    stop = StopRequest().on_signals()

    def on_ready() -> None:
        if as_json:
            json_line(ready=True)

    with node_progress(chosen, as_json) as on_tick:
        summary = run_controller(
            chosen,
            bus,
            stop,
            on_ready,
            Throttled(on_tick),
            RunOptions(real_time, by_hand=True, timeouts=timeouts, controller=running),
        )
        on_tick(summary.ticks)
    sys.exit(end_of_node(chosen, summary, as_json))
