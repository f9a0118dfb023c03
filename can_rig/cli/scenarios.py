"""``can-rig scenarios``."""

import tomllib

import click

from can_rig.cli.options import json_option
from can_rig.cli.output import json_line, show, table
from can_rig.scenario import shipped


@click.command("scenarios")
@json_option("Name and description of each as one JSON object.")
def command(as_json: bool) -> None:
    """List the scenarios that come with the package."""
    described = {
        name: tomllib.loads(path.read_text(encoding="utf-8"))["description"]
        for name, path in shipped().items()
    }
    if as_json:
        json_line(**described)
        return
    listed = table("scenario", "what it shows", left=2)
    for name, description in described.items():
        listed.add_row(name, description)
    show(listed)
