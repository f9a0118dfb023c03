"""``can-rig``: the command line."""

from __future__ import annotations

import sys
from typing import Any

import click
from rich.console import Console

from can_rig.cli.design_cli import bus_timing, check, figures, scenarios, tune
from can_rig.cli.log_cli import decode, diff, plot, replay
from can_rig.cli.node_cli import controller, plant, run
from can_rig.errors import INTERRUPTED, RigError


class RigGroup(click.Group):
    """Shows the rig's own errors as one line and exits with their status."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; bad input never reaches the user as a traceback."""
        try:
            return super().invoke(ctx)
        except RigError as error:
            Console(stderr=True, soft_wrap=True).print(
                f"error: {error}", style="red", markup=False, highlight=False
            )
            sys.exit(error.exit_status)
        except KeyboardInterrupt:  # while it still starts; later a run ends between two ticks
            sys.exit(INTERRUPTED)


@click.group(cls=RigGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="fault-tolerant-steering", prog_name="can-rig")
def main() -> None:
    """A fault-tolerant steering controller and a simulated car, over CAN.

    Exit status: 0 done, 1 the answer is no, 2 bad input, 3 a node or the bus fell silent,
    130 stopped by Ctrl-C.
    """


for _command in (
    *(run, plant, controller),
    *(scenarios, check, bus_timing, tune, figures),
    *(decode, replay, plot, diff),
):
    main.add_command(_command)
