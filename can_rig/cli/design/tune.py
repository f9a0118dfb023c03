"""``can-rig tune``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from can_rig.assessment.tuning.report import tune_command
from can_rig.cli.options import json_option, scenario_options


@click.command("tune")
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
    help="Ticks of delay, beyond the scenario's own, that must be survived.",
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
@click.option("--force", is_flag=True, help="Replace the picture if it exists.")
@json_option("The trade-off as one JSON object.")
def command(
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
    limits = (spare_ticks, noise_limit_n, torque_noise_limit_nm)
    sys.exit(tune_command(scenario, settings, (box, box_settings), limits, out, force, as_json))
