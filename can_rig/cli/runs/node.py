"""Shared parts of the commands ``plant`` and ``controller``: options, progress, last lines."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict

import click

from can_rig.cli.options import (
    Function,
    above_zero,
    bus_option,
    json_option,
    realtime_option,
    silence_option,
)
from can_rig.cli.output import json_line, tell
from can_rig.cli.progress import counting
from can_rig.errors import INTERRUPTED, RigError
from can_rig.nodes.clock import OnTick
from can_rig.nodes.realtime import timing
from can_rig.nodes.ticks import NodeSummary
from can_rig.scenario.settings import Scenario


def node_options(function: Function) -> Function:
    """The options of both nodes, beyond SCENARIO and --set."""
    for decorate in (
        bus_option("local", "local"),
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
def node_progress(scenario: Scenario, as_json: bool) -> Iterator[OnTick]:
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


def end_of_node(scenario: Scenario, summary: NodeSummary, as_json: bool) -> int:
    """Say how it went: the exit status."""
    if as_json:
        json_line(**asdict(summary))
        return 0
    tell(f"{summary.ticks} of {scenario.ticks} ticks, {summary.ticks_per_s:.0f} a second")
    realtime = summary.realtime or {}
    tell(*(f"{label}: {text}" for label, text in timing.rows(realtime)))
    tell(*timing.scheduling_lines(realtime))
    return 0 if summary.ticks == scenario.ticks else INTERRUPTED
