"""``can-rig export``."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import get_args

import click

from can_rig.assessment.resolve import load
from can_rig.cli.options import force_option, scenario_options
from can_rig.cli.output import explain, say, show, table
from can_rig.export.application import exported, in_precision, write
from can_rig.export.boards import COMPILER, EMULATOR
from can_rig.export.fmu import write_fmu
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import Precision


@click.command("export")
@scenario_options
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="Where to write it.",
)
@click.option(
    "--precision",
    type=click.Choice(get_args(Precision)),
    help="Of every real number.  [default: the scenario's design.precision]",
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
    help="Write FOLDER/SCENARIO.fmu in place of the folder: FMI 3.0, co-simulation, with the C "
    "sources and this machine's binary.",
)
@click.option(
    "--report",
    is_flag=True,
    help="Also say what it costs on emulated boards, how much of it random trials run, and what "
    "compilers and analysers find.",
)
@force_option
def command(
    scenario: str,
    settings: tuple[str, ...],
    out: Path,
    precision: Precision | None,
    prefix: str | None,
    as_fmu: bool,
    report: bool,
    force: bool,
) -> None:
    """Write SCENARIO's controller as C99, with its constants and a makefile.

    The C code is a translation of the Python code behind `can-rig run`, with the same bits in every
    tick. Applications call FOLDER/firmware.h; `make -C FOLDER` builds an example.
    """
    chosen = load(scenario, settings)
    if as_fmu:
        if report or prefix is not None:
            option = "--report" if report else "--prefix"
            raise click.UsageError(f"--fmu and {option} do not go together")
        say(str(write_fmu(in_precision(chosen, precision) if precision else chosen, out, force)))
        return
    files = exported(chosen, precision, prefix)
    write(files, out, force)
    lines = sum(text.count("\n") for name, text in files.items() if name.endswith((".c", ".h")))
    say(f"{out}: {len(files)} files, {lines} lines of C")
    if report:
        _report(chosen, files)


def _report(scenario: Scenario, files: dict[str, str]) -> None:
    """Costs of the law on each board, coverage by the trials, and findings on the files."""
    _costs(scenario)
    _trials(scenario)
    _findings(files)


def _costs(scenario: Scenario) -> None:
    """The costs on each board with an installed compiler and emulator."""
    from can_rig.export.costs import VARIANTS, cost  # noqa: PLC0415
    from can_rig.export.findings import NOT_INSTALLED  # noqa: PLC0415
    from can_rig.plant.frameless import controller_inputs  # noqa: PLC0415

    if shutil.which(COMPILER) is None:
        for board, precision in VARIANTS:
            say(f"{board}, {precision}: {NOT_INSTALLED} ({COMPILER})")
        return
    counted = shutil.which(EMULATOR) is not None
    inputs = controller_inputs(scenario) if counted else None
    headings = ("median", "worst", "in tick", "node") if counted else ()
    figures = table("", "code", "constants", "state", "stack", *headings)
    for board, precision in VARIANTS:
        each = cost(scenario, board, precision, inputs)
        numbers = (each.code_bytes, each.constant_bytes, each.state_bytes, each.stack_bytes)
        ticks = (each.median, each.worst, each.worst_tick, each.node_median) if counted else ()
        figures.add_row(
            f"{each.board}, {each.precision}", *(f"{number:.0f}" for number in (*numbers, *ticks))
        )
    show(figures)
    if counted:
        explain(
            "Bytes, and instructions a tick of the law, in the run of this scenario on QEMU; node: "
            "median with frames and their protection."
        )
    else:
        say("Bytes.", f"instructions a tick: {NOT_INSTALLED} ({EMULATOR})")


def _trials(scenario: Scenario) -> None:
    """Random memory and frames through the C code: differences from Python, unexecuted lines."""
    from can_rig.export.findings import (  # noqa: PLC0415
        NOT_INSTALLED,
        TOOLS,
        coverage,
    )

    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        say(f"random memory and frames: {NOT_INSTALLED} ({', '.join(missing)})")
        return
    found = coverage(scenario)
    say(f"random memory, C against Python: {found.different} of {found.compared} states differ")
    say(
        f"run by random memory and frames: {found.lines_run} of {found.lines} lines, "
        f"{found.branches_taken} of {found.branches} branches; "
        f"not run: {', '.join(found.missed) or 'none'}"
    )


def _findings(files: dict[str, str]) -> None:
    from can_rig.export.findings import (  # noqa: PLC0415
        DEVIATIONS,
        NOT_INSTALLED,
        eva,
        findings,
        misra,
    )

    for tool, n in findings(files).items():
        say(f"{tool}: {n if isinstance(n, str) else f'{n} findings'}")
    rules = misra(files)
    if rules is None:
        say(f"MISRA C:2012: {NOT_INSTALLED} (cppcheck)")
    else:
        others = {rule: n for rule, n in rules.items() if rule not in DEVIATIONS}
        said = ", ".join(f"rule {rule}: {n}" for rule, n in sorted(others.items())) or "0 findings"
        say(f"MISRA C:2012 (cppcheck): {said}, and these deviations:")
        for rule, why in DEVIATIONS.items():
            say(f"    rule {rule}, {rules[rule]} times: {why}")
    alarms = eva(files)
    if alarms is None:
        say(f"Frama-C Eva: {NOT_INSTALLED}")
    else:
        say(f"Frama-C Eva: {len(alarms)} alarms")
        for alarm in alarms:
            say(f"    {alarm}")
