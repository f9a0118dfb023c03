"""``can-rig check``."""

import sys

import click

from can_rig.assessment.speeds import check
from can_rig.assessment.stability import table_rows
from can_rig.cli.options import json_option, scenario_options
from can_rig.cli.output import car_bar, explain, json_line, say, show_beside
from can_rig.scenario.driving import notes_of_drive
from can_rig.scenario.loading import load


@click.command("check")
@scenario_options
@json_option("The figures as one JSON object.")
def command(scenario: str, settings: tuple[str, ...], as_json: bool) -> None:
    """Check whether SCENARIO's loop is stable, healthy and faulted, and by which margins.

    Exit status: 0 stable; 1 not, or with a thin margin.
    """
    with car_bar() as on_car:
        result = check(load(scenario, settings), on_car)
    if as_json:
        json_line(**result.as_dict())
    else:
        show_beside(*table_rows(result.states))
        explain(*result.notes, *result.scenario.notes, *notes_of_drive(result.scenario))
        say(result.verdict)
    sys.exit(0 if result.stable else 1)
