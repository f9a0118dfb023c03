"""``can-rig plant``."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import click

from can_rig.assessment.resolve import load
from can_rig.cli.options import (
    force_option,
    interaction_of,
    interaction_options,
    scenario_options,
)
from can_rig.cli.runs.node import end_of_node, node_options, node_progress
from can_rig.errors import LogError
from can_rig.nodes.bus_access import StopRequest, Timeouts
from can_rig.nodes.clock import Throttled
from can_rig.nodes.recording import recorded_log
from can_rig.nodes.runner import RunOptions, run_plant

OTHER_FORMATS = {".asc", ".blf", ".trc", ".mf4", ".gz"}
"""Of logs; a node writes candump lines as it goes."""


@click.command("plant")
@scenario_options
@node_options
@click.option(
    "--log", type=click.Path(path_type=Path, dir_okay=False), help="Record candump lines here."
)
@interaction_options
@force_option
def command(
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
    if log is not None and log.suffix.lower() in OTHER_FORMATS:
        raise LogError(
            f"{log}: must be FILE.log, a node records candump lines as it goes; "
            "can-rig run --log writes other formats"
        )
    interaction = interaction_of(pace, injectable, real_time)
    alone_s = math.inf if real_time else Timeouts.silence_s
    timeouts = Timeouts(first_s, alone_s if silence_s is None else silence_s)
    chosen = load(scenario, settings)
    stop = StopRequest().on_signals()
    with recorded_log(log, force) as recording, node_progress(chosen, as_json) as on_tick:
        summary = run_plant(
            chosen,
            bus,
            recording.path,
            stop,
            recording.before(Throttled(on_tick)),
            RunOptions(real_time, by_hand=True, timeouts=timeouts, interaction=interaction),
        )
        on_tick(summary.ticks)
    sys.exit(end_of_node(chosen, summary, as_json))
