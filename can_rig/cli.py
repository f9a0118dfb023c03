"""``can-rig``: the command line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from rich.console import Console

from can_rig.errors import RigError

INTERRUPTED = 130  # what a shell reports for Ctrl-C

Function = TypeVar("Function", bound=Callable[..., Any])


class RigGroup(click.Group):
    """Shows the rig's own errors as one line and exits with their status."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; bad input never reaches the user as a traceback."""
        try:
            return super().invoke(ctx)
        except RigError as error:
            Console(stderr=True, soft_wrap=True).print(
                f"error: {error}", style="red", markup=False, highlight=False
            )
            sys.exit(error.exit_status)
        except KeyboardInterrupt:  # while it still starts; later a run ends between two ticks
            sys.exit(INTERRUPTED)


@click.group(cls=RigGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="fault-tolerant-steering", prog_name="can-rig")
def main() -> None:
    """A fault-tolerant steering controller and a simulated car, over CAN.

    Exit status: 0 done, 2 bad input, 3 a node fell silent, 130 stopped by Ctrl-C.
    """


def bus_option(default: str | None, shown: str) -> Callable[[Function], Function]:
    """--bus, with its own default."""
    return click.option(
        "--bus",
        default=default,
        metavar="NAME",
        help="local[:NAME], socketcan:vcan0, udp_multicast:ADDRESS, or any python-can "
        f"INTERFACE:CHANNEL?KEY=VALUE.  [default: {shown}]",
    )


def scenario_options(function: Function) -> Function:
    """SCENARIO and --set, which every command that runs something takes."""
    for decorate in (
        click.option(
            "--set",
            "settings",
            multiple=True,
            metavar="KEY=VALUE",
            help="Change one key of the scenario, as in plant.speed_mps=20; repeatable.",
        ),
        click.argument("scenario", default="thesis-step"),
    ):
        function = decorate(function)
    return function


@main.command()
@scenario_options
@bus_option(None, "a local bus of its own")
@click.option("--out", type=click.Path(path_type=Path), help="Run folder [runs/SCENARIO-TIME].")
@click.option("--force", is_flag=True, help="Replace the run folder if it is there.")
@click.option("--in-process", is_flag=True, help="Both nodes in this process; the same log.")
@click.option("--allow-unstable", is_flag=True, help="Run a loop that `can-rig check` refuses.")
def run(
    scenario: str,
    settings: tuple[str, ...],
    bus: str | None,
    out: Path | None,
    force: bool,
    in_process: bool,
    allow_unstable: bool,
) -> None:
    """Run both nodes through SCENARIO and collect the run folder."""
    from can_rig.commands import run_command  # noqa: PLC0415 (imports what only a run needs)

    sys.exit(run_command(scenario, settings, bus, out, force, in_process, allow_unstable))


@main.command()
@scenario_options
@click.option("--json", "as_json", is_flag=True, help="The figures as one JSON object.")
def check(scenario: str, settings: tuple[str, ...], as_json: bool) -> None:
    """Say whether SCENARIO's loop is stable, healthy and faulted, and by how much.

    Exit status: 0 stable, 1 not.
    """
    from can_rig.commands import check_command  # noqa: PLC0415

    sys.exit(check_command(scenario, settings, as_json))


def _above_zero(_context: click.Context, _option: click.Parameter, value: float) -> float:
    if not value > 0.0:  # nan too
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
            default=1.0,
            callback=_above_zero,
            show_default=True,
            metavar="S",
            help="Seconds of silence after which the other node counts as gone.",
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
    ):
        function = decorate(function)
    return function


@main.command()
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
    silence_s: float,
    first_s: float,
    as_json: bool,
) -> None:
    """Run the plant node: the simulated car, in lockstep with a controller node."""
    from can_rig.commands import plant_command  # noqa: PLC0415

    sys.exit(plant_command(scenario, settings, bus, log, (first_s, silence_s), as_json))


@main.command()
@scenario_options
@node_options
def controller(
    scenario: str,
    settings: tuple[str, ...],
    bus: str,
    silence_s: float,
    first_s: float,
    as_json: bool,
) -> None:
    """Run the controller node: the firmware, in lockstep with a plant node."""
    from can_rig.commands import controller_command  # noqa: PLC0415

    sys.exit(controller_command(scenario, settings, bus, (first_s, silence_s), as_json))


@main.command("bus")
@scenario_options
@click.option(
    "--dbc",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Look at all messages of this DBC that have a cycle time, not at the scenario.",
)
@click.option(
    "--bitrate",
    type=click.IntRange(min=1),
    metavar="BIT/S",
    help="Nominal bit rate.  [default: the scenario's bus.bitrate]",
)
@click.option(
    "--data-bitrate",
    type=click.IntRange(min=1),
    metavar="BIT/S",
    help="Bit rate of the data phase of FD frames.  [default: they do not switch]",
)
@click.option("--json", "as_json", is_flag=True, help="One line of JSON.")
def bus_timing(
    scenario: str,
    settings: tuple[str, ...],
    dbc: Path | None,
    bitrate: int | None,
    data_bitrate: int | None,
    as_json: bool,
) -> None:
    """Say when the frames arrive at worst, and the latency in ticks that follows.

    Exit status: 0 if every frame is sure to be sent in time, 1 if not.
    """
    from can_rig.bus_table import bus_command  # noqa: PLC0415

    sys.exit(bus_command(scenario, settings, dbc, (bitrate, data_bitrate), as_json))


@main.command()
@scenario_options
@click.option(
    "--box",
    default=0.2,
    show_default=True,
    metavar="SHARE",
    help="By how much mass, both cornering stiffnesses and speed may be off: 0.2 for ±20 %.",
)
@click.option(
    "--box-set",
    "box_settings",
    multiple=True,
    metavar="KEY=LOW..HIGH",
    help="Range of one parameter of the car, as in plant.speed_mps=8..12; repeatable.",
)
@click.option(
    "--spare-ticks",
    default=1,
    show_default=True,
    metavar="N",
    help="More ticks of delay that have to be survived.",
)
@click.option(
    "--noise-limit",
    "noise_limit_n",
    type=float,
    metavar="N",
    help="Largest rms of X_diff that noise.dstar_rms_mps2 may cause, in N.  [default: any]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default="tuning",
    show_default=True,
    help="Folder of tuning.png.",
)
@click.option("--force", is_flag=True, help="Replace the picture if it is there.")
@click.option("--json", "as_json", is_flag=True, help="The trade-off as one JSON object.")
def tune(
    scenario: str,
    settings: tuple[str, ...],
    box: float,
    box_settings: tuple[str, ...],
    spare_ticks: int,
    noise_limit_n: float | None,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Choose tau, tau_q, alpha and alpha_q for SCENARIO: least peak after the loss of the torque.

    Every choice is stable with ticks to spare, healthy and faulted, for a box of cars around the
    one that it is designed for.  Exit status: 0 found, 1 not within --noise-limit.
    """
    from can_rig.tuning_report import tune_command  # noqa: PLC0415

    limits = (spare_ticks, noise_limit_n)
    sys.exit(tune_command(scenario, settings, (box, box_settings), limits, out, force, as_json))


@main.command()
def scenarios() -> None:
    """List the scenarios that come with the package."""
    from can_rig.commands import scenarios_command  # noqa: PLC0415

    scenarios_command()


@main.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default="figures",
    show_default=True,
    help="Folder of the PNG files.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Change one key of every figure's scenario, as in tick_s=0.0001; repeatable.",
)
@click.option("--force", is_flag=True, help="Replace figures that are there.")
def figures(out: Path, settings: tuple[str, ...], force: bool) -> None:
    """Draw Figs. 2.2-2.4, 3.5, 3.6 of the thesis: the firmware over the continuous loop."""
    from can_rig.commands import figures_command  # noqa: PLC0415

    figures_command(settings, out, force)
