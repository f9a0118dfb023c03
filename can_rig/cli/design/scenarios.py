"""``can-rig scenarios``."""

from __future__ import annotations

import tomllib

import click

from can_rig.cli.output import show, table
from can_rig.scenario.catalogue import shipped


@click.command("scenarios")
def command() -> None:
    """List the scenarios that come with the package."""
    listed = table("scenario", "what it shows", left=2)
    for name, path in shipped().items():
        listed.add_row(name, tomllib.loads(path.read_text(encoding="utf-8"))["description"])
    show(listed)
