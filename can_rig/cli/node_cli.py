"""The commands of ``can-rig`` that run nodes."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import click

from can_rig.cli.options import Function, scenario_options


def bus_option(default: str | None, shown: str) -> Callable[[Function], Function]:
    """--bus, with its own default."""
    return click.option(
        "--bus",
        default=default,
        metavar="NAME",
        help="local[:NAME], socketcan:vcan0, udp_multicast:ADDRESS, or any python-can "
        f"INTERFACE:CHANNEL?KEY=VALUE.  [default: {shown}]",
    )


def realtime_option(function: Function) -> Function:
    """--realtime."""
    return click.option(
        "--realtime",
        "real_time",
        is_flag=True,
        help="Absolute deadlines of the wall clock, one a tick; late commands count as lost. "
        "Takes a latency of a tick or more.",
    )(function)


@click.command()
@scenario_options
@bus_option(None, "a local bus of its own")
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [runs/SCENARIO-TIME].")
@click.option("--force", is_flag=True, help="Replace the run folder if it is there.")
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
def run(
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
        raise click.UsageError("--in-process --realtime: real time takes two processes; either")
    from can_rig.cli.run_command import run_command  # noqa: PLC0415 (imports what only a run needs)

    sys.exit(
        run_command(
            scenario, settings, bus, out, force, logs, in_process, allow_unstable, real_time
        )
    )


def _above_zero(
    _context: click.Context, _option: click.Parameter, value: float | None
) -> float | None:
    if value is not None and not value > 0.0:  # nan too
        raise click.BadParameter(f"{value:g} s: above 0 is right")
    return value


def node_options(function: Function) -> Function:
    """What both nodes take beside the scenario."""
    for decorate in (
        bus_option("local", "local"),
        click.option("--json", "as_json", is_flag=True, help="Progress and summary as JSON lines."),
        click.option(
            "--silence",
            "silence_s",
            type=float,
            callback=_above_zero,
            metavar="S",
            help="Seconds of silence after which the other node counts as gone.  [default: 1.0; "
            "plant --realtime drives on alone]",
        ),
        click.option(
            "--wait",
            "first_s",
            default=60.0,
            callback=_above_zero,
            show_default=True,
            metavar="S",
            help="Seconds to wait for the other node to appear.",
        ),
        realtime_option,
    ):
        function = decorate(function)
    return function


@click.command()
@scenario_options
@node_options
@click.option(
    "--log", type=click.Path(path_type=Path, dir_okay=False), help="Record candump lines here."
)
def plant(
    scenario: str,
    settings: tuple[str, ...],
    bus: str,
    log: Path | None,
    silence_s: float | None,
    first_s: float,
    as_json: bool,
    real_time: bool,
) -> None:
    """Run the plant node: the simulated car, in lockstep with a controller node or in real time.

    In real time it goes on without the controller node: actuators hold, then drop to zero.
    """
    from can_rig.cli.node_commands import plant_command  # noqa: PLC0415
    from can_rig.nodes.watchdog import Timeouts  # noqa: PLC0415

    alone = math.inf if real_time else Timeouts.silence_s
    timeouts = Timeouts(first_s, alone if silence_s is None else silence_s)
    sys.exit(plant_command(scenario, settings, bus, log, timeouts, as_json, real_time))


@click.command()
@scenario_options
@node_options
def controller(
    scenario: str,
    settings: tuple[str, ...],
    bus: str,
    silence_s: float | None,
    first_s: float,
    as_json: bool,
    real_time: bool,
) -> None:
    """Run the controller node: the firmware, in lockstep with a plant node or in real time.

    In real time it may be started, or started again, while the car drives: it listens for 50 ms,
    then takes over without a bump.
    """
    from can_rig.cli.node_commands import controller_command  # noqa: PLC0415
    from can_rig.nodes.watchdog import Timeouts  # noqa: PLC0415

    timeouts = Timeouts(first_s, Timeouts.silence_s if silence_s is None else silence_s)
    sys.exit(controller_command(scenario, settings, bus, timeouts, as_json, real_time))
