"""``can-rig export``."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import click

from can_rig.assessment.resolve import load
from can_rig.cli.options import force_option, scenario_options
from can_rig.cli.output import say
from can_rig.export.folder import exported, write
from firmware_model.target.structs import Precision


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
@force_option
def command(
    scenario: str,
    settings: tuple[str, ...],
    out: Path,
    precision: Precision | None,
    force: bool,
) -> None:
    """Write SCENARIO's controller as C99, with its constants and what builds it.

    The C is translated from the lines that `can-rig run` runs, and has the same bits in every
    tick. FOLDER/firmware.h is what an application calls; `make -C FOLDER` builds an example.
    """
    files = exported(load(scenario, settings), precision)
    write(files, out, force)
    lines = sum(text.count("\n") for name, text in files.items() if name.endswith((".c", ".h")))
    say(f"{out}: {len(files)} files, {lines} lines of C")
