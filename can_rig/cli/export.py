"""``can-rig export``."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, get_args

import click

from can_rig.campaigns.plan import Plan, plan
from can_rig.campaigns.settings import read_campaign
from can_rig.cli.options import force_option, scenario_options
from can_rig.cli.output import progress, say, tell
from can_rig.errors import ExportError
from can_rig.export.application import exported, in_precision, refuse_export, write
from can_rig.export.controller_fmu import controller_model, node_model
from can_rig.export.fmu import name_of, write_fmus
from can_rig.plant.car_fmu import car_model, write_inputs
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.fault_settings import FaultKind, FaultSettings
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import fingerprint
from firmware_model.law.structs import FloatArray, Precision

FAULTS: Final[
    tuple[tuple[str, FaultKind, Literal["torque", "force-difference", "sensor"]], ...]
] = (
    ("channel 1 lost", "actuator-dead", "torque"),
    ("channel 2 lost", "actuator-dead", "force-difference"),
    ("channel 1 stuck", "actuator-stuck", "torque"),
    ("frames of the sensor missing", "frames-missing", "sensor"),
    ("sensor stuck", "sensor-stuck", "sensor"),
)
"""Runs whose worst tick is measured, beside the scenario's own: the fault in the middle."""


RUNS: Final = 100
"""Of each campaign, unless ``--runs`` says another number."""


@click.command("export")
@scenario_options
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="Folder of the files.",
)
@click.option(
    "--precision",
    type=click.Choice(get_args(Precision)),
    help="Precision of every real number.  [default: the scenario's design.precision]",
)
@click.option(
    "--prefix",
    metavar="NAME",
    help="Begin every external name with NAME_, so that several exports link into one program.",
)
@click.option(
    "--fmu",
    "as_fmu",
    is_flag=True,
    help="Write FMUs of the controller, of the controller with its CAN frames and of the car in "
    "place of the folder: FOLDER/fmi2 and FOLDER/fmi3, with C sources and this machine's binary.",
)
@click.option(
    "--evidence",
    "with_evidence",
    is_flag=True,
    help="Also measure, into FOLDER/evidence.html and .json: size, stack, instructions on emulated "
    "boards, random trials against Python with their coverage and MC/DC, mutants, findings of "
    "analysers, MISRA C.",
)
@click.option(
    "--campaign",
    "campaigns",
    metavar="NAME",
    multiple=True,
    help="With --evidence: count instructions in the runs of this campaign too; may be given "
    "several times.",
)
@click.option(
    "--runs", type=click.IntRange(1), help=f"Number of runs of each campaign.  [default: {RUNS}]"
)
@force_option
def command(
    scenario: str,
    settings: tuple[str, ...],
    out: Path,
    precision: Precision | None,
    prefix: str | None,
    as_fmu: bool,
    with_evidence: bool,
    campaigns: tuple[str, ...],
    runs: int | None,
    force: bool,
) -> None:
    """Write SCENARIO's controller as C99, with its constants and a makefile.

    The C code is a translation of the Python code behind `can-rig run`, with the same bits in every
    tick. Applications call FOLDER/firmware.h; `make -C FOLDER` builds an example.
    """
    if campaigns and not with_evidence:
        raise click.UsageError("--campaign: must come with --evidence")
    if runs is not None and not campaigns:
        raise click.UsageError("--runs: must come with --evidence and --campaign")
    if not as_fmu:
        refuse_export(out, force)
    chosen = load(scenario, settings)
    if precision is not None:
        chosen = in_precision(chosen, precision)
    if as_fmu:
        if with_evidence or prefix is not None:
            option = "--evidence" if with_evidence else "--prefix"
            raise click.UsageError(f"--fmu and {option} do not go together")
        _write_fmus(chosen, out, force)
        return
    files = exported(chosen, prefix)
    own = [*settings, f'design.precision="{chosen.design.precision}"']
    plans = [plan(read_campaign(each, own, scenario=[scenario])) for each in campaigns]
    write(files, out, force)
    lines = sum(text.count("\n") for name, text in files.items() if name.endswith((".c", ".h")))
    say(f"{out}: {len(files)} files, {lines} lines of C")
    if with_evidence:
        write(files | _record(chosen, files, plans, runs or RUNS), out, force=True)
        say(f"{out / 'evidence.html'}, and the same as evidence.json")


def _write_fmus(scenario: Scenario, out: Path, force: bool) -> None:
    car = car_model(scenario)
    for model in (controller_model(scenario), node_model(scenario), *([car] if car else [])):
        for path in write_fmus(model, out, force):
            say(str(path))
    if car is None:
        say("no FMU of the car: plant must be linear, without a drive and without disturbances")
        return
    inputs = out / f"{name_of('inputs', scenario)}.csv"
    for fault in write_inputs(scenario, inputs, force):
        tell(f"{inputs}: has no input for {fault.kind}")
    say(str(inputs))


def _record(
    scenario: Scenario, files: dict[str, str], plans: list[Plan], runs: int
) -> dict[str, str]:
    """``evidence.json`` and ``evidence.html``, with runs of the scenario, faults and campaigns."""
    from can_rig.export.evidence import as_page, evidence  # noqa: PLC0415
    from can_rig.plant.frameless import controller_inputs  # noqa: PLC0415

    own = {"as in the scenario": scenario}
    for name, kind, channel in FAULTS:
        fault = FaultSettings(kind=kind, channel=channel, at_s=scenario.duration_s / 2)
        own[name] = replace(scenario, fault=(fault,))
    inputs = {name: controller_inputs(each) for name, each in own.items()}
    of_campaigns: dict[str, dict[str, FloatArray]] = {each.settings.name: {} for each in plans}
    with progress("evidence", "steps") as bar:
        for each in plans:
            last = min(each.runs, each.searched + runs)
            for number in range(each.searched, last):
                run, choices = each.scenario_of(number), each.values_of(number)
                _require_same_law(scenario, run, f"campaign {each.settings.name}: run {number}")
                said = [str(choices[key]) for key in each.settings.choices]
                name = ", ".join([str(number), *said])
                of_campaigns[each.settings.name][name] = controller_inputs(run)
                bar.count(number - each.searched + 1, last - each.searched)
        record = evidence(scenario, files, inputs, of_campaigns, bar.count)
    return {"evidence.json": json.dumps(record, indent=2) + "\n", "evidence.html": as_page(record)}


def _require_same_law(one: Scenario, other: Scenario, where: str) -> None:
    """Refuse a run with constants that are not the exported ones."""
    of, its = (controls(each, network_of(each)) for each in (one, other))
    if fingerprint(its.table, its.schedule) != fingerprint(of.table, of.schedule):
        raise ExportError(
            f"{where}: has a controller with other constants than the exported one; axes and "
            "settings must leave the design as it is"
        )
