"""``can-rig panel``: a web page on this machine to watch and touch a run."""

import click

from can_rig.cli.options import bus_of_processes, scenario_options
from can_rig.cli.output import say
from can_rig.scenario import shipped


@click.command("panel")
@scenario_options
@click.option(
    "--bus",
    callback=bus_of_processes,
    metavar="NAME",
    help="Show nodes that run on this bus, and start none.  [default: a local bus of its own]",
)
@click.option(
    "--allow-control", is_flag=True, help="With --bus: also send the commands of the page."
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="Port of 127.0.0.1; 0: a free port.  [default: 8035, or else a free port]",
)
def command(
    scenario: str, settings: tuple[str, ...], bus: str | None, allow_control: bool, port: int | None
) -> None:
    """Watch and control a run of SCENARIO in a browser on this machine.

    The command prints two addresses, each with a token of this start: an address for watching and
    touching the run, and an address for watching only.
    """
    from can_rig.panel.server import serve  # noqa: PLC0415 (aiohttp is slow to import)

    names = [] if bus else list(shipped())
    serve(scenario, settings, names, bus, allow_control or bus is None, port, say)
