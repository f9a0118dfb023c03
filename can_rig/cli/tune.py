"""``can-rig tune``."""

import sys
from pathlib import Path

import click

from can_rig.assessment.tuning.candidate import NoTuningError, cars_of, refusals_as_dict
from can_rig.assessment.tuning.report import as_dict, headings, options, picture, rows, why
from can_rig.assessment.tuning.search import Tunings, tune
from can_rig.cli.options import json_option, scenario_options
from can_rig.cli.output import json_line, progress, say, show, table
from can_rig.scenario.loading import load
from can_rig.storage.files import atomic, refuse_existing

PICTURE = "tuning.png"


@click.command("tune")
@scenario_options
@click.option(
    "--box",
    default=0.2,
    show_default=True,
    metavar="SHARE",
    help="By how much mass, both cornering stiffnesses and speed may differ, or gains and speeds "
    "of a plant by numbers: 0.2 for ±20 %.",
)
@click.option(
    "--box-set",
    "box_settings",
    multiple=True,
    metavar="KEY=LOW..HIGH",
    help="Range of one parameter of the car, as in plant.speed_mps=8..12, or of a plant by "
    "numbers, as in plant.gain_1=0.7..1.3; repeatable.",
)
@click.option(
    "--spare-ticks",
    default=1,
    show_default=True,
    metavar="N",
    help="Ticks of delay, beyond the scenario's own, with which the loop must be stable.",
)
@click.option(
    "--noise-limit",
    "noise_limit_n",
    type=float,
    metavar="N",
    help="Largest rms of X_diff, or of input 2, that plant.sensor.noise_mps2 may cause, in N or "
    "its own unit.  [default: any]",
)
@click.option(
    "--torque-noise-limit",
    "torque_noise_limit_nm",
    type=float,
    metavar="NM",
    help="Largest rms of the torque, or of input 1, that this noise may cause.  [default: any]",
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

    The peak is that of a drive without noise, of a plant that the decision knows exactly; with
    noise, or with budget.box, a run may have twice as much and more.

    Every candidate is stable with spare ticks of delay, healthy and faulted, for a box of cars
    around the nominal car.  Exit status: 0 found, 1 no stable candidate, or none within
    --noise-limit.
    """
    drawn = out / PICTURE
    refuse_existing(drawn, force, "--out", new_folder=True)
    chosen = load(scenario, settings)
    some = cars_of(chosen, box, box_settings)
    try:
        with progress(chosen.name, "tunings") as bar:
            found = tune(
                chosen, some, spare_ticks, noise_limit_n, torque_noise_limit_nm,
                on_progress=bar.count,
            )  # fmt: skip
    except NoTuningError as error:
        _tell_refusals(error, as_json)
        sys.exit(error.exit_status)
    with atomic(drawn, force=force) as part:
        picture(found).savefig(part, dpi=200)
    if as_json:
        json_line(**as_dict(found), picture=str(drawn))
    else:
        _print(found, drawn)


def _print(found: Tunings, drawn: Path) -> None:
    tunings = table("", *headings(found))
    for tuning, cells in rows(found):
        chosen = tuning is found.chosen
        tunings.add_row(">" if chosen else "", *cells, style="bold" if chosen else None)
    show(tunings)
    say(f"chosen: {why(found)}", options(found.chosen), f"picture  {drawn}")


def _tell_refusals(error: NoTuningError, as_json: bool) -> None:
    if as_json:
        refused = refusals_as_dict(error.refusals)
        json_line(chosen=None, refused=refused, advice=error.advice)
        return
    refused_rows = table("tunings", "refused because", left=0)
    refused_rows.columns[1].justify = "left"
    for reason, count in error.rows:
        refused_rows.add_row(str(count), reason)
    show(refused_rows)
    say(f"none of {error.refusals.total()} tunings passes: {error.advice}")
