"""Options that commands of ``can-rig`` share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

Function = TypeVar("Function", bound=Callable[..., Any])


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
        click.argument("scenario", default="default"),
    ):
        function = decorate(function)
    return function
