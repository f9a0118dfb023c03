"""The commands of ``can-rig`` around a run: what there is, is it stable, what tuning, what bus."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from can_rig.cli.options import scenario_options


@click.command()
def scenarios() -> None:
    """List the scenarios that come with the package."""
    from can_rig.cli.design_commands import scenarios_command  # noqa: PLC0415

    scenarios_command()


@click.command()
@scenario_options
@click.option("--json", "as_json", is_flag=True, help="The figures as one JSON object.")
def check(scenario: str, settings: tuple[str, ...], as_json: bool) -> None:
    """Say whether SCENARIO's loop is stable, healthy and faulted, and by how much.

    Exit status: 0 stable, 1 not.
    """
    from can_rig.cli.design_commands import check_command  # noqa: PLC0415

    sys.exit(check_command(scenario, settings, as_json))


@click.command("bus")
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
    from can_rig.assessment.bus_timing.table import bus_command  # noqa: PLC0415

    sys.exit(bus_command(scenario, settings, dbc, (bitrate, data_bitrate), as_json))


@click.command()
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
    "--torque-noise-limit",
    "torque_noise_limit_nm",
    type=float,
    metavar="NM",
    help="Largest rms of the torque that it may cause, in N m.  [default: any]",
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
    torque_noise_limit_nm: float | None,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Choose tau, tau_q, alpha and alpha_q for SCENARIO: least peak after the loss of the torque.

    Every choice is stable with ticks to spare, healthy and faulted, for a box of cars around the
    one that it is designed for.  Exit status: 0 found, 1 not within --noise-limit.
    """
    from can_rig.cli.tune_command import tune_command  # noqa: PLC0415

    limits = (spare_ticks, noise_limit_n, torque_noise_limit_nm)
    sys.exit(tune_command(scenario, settings, (box, box_settings), limits, out, force, as_json))


@click.command()
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
    from can_rig.cli.figures_command import figures_command  # noqa: PLC0415

    figures_command(settings, out, force)
