"""Whether every controller puts the same bytes on the bus, in runs of a campaign.

The first runs of ``faults`` have faults of every kind, noise and other cars. Each run is driven
by the law in Python and by each other controller, in both precisions, and the logs are compared.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import click
from rich.console import Console
from rich.progress import track

from can_rig.campaigns.plan import plan
from can_rig.campaigns.settings import read_campaign
from can_rig.controllers import CONTROLLERS
from can_rig.controllers.making import controller_of
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from can_rig.scenario.settings import Scenario

WITHOUT_PROMISE = ("arm:m4f", "float64")
"""A board whose double precision is libgcc's, which is wrong in some last bits."""


@click.command()
@click.option("--campaign", default="faults", show_default=True, help="A shipped one.")
@click.option("--runs", default=20, show_default=True, help="The first ones of the campaign.")
@click.option("--duration", "duration_s", default=8.0, show_default=True, help="Of each, in s.")
def main(campaign: str, runs: int, duration_s: float) -> None:
    """Compare bus.log of every controller with that of the law in Python."""
    drawn = plan(read_campaign(campaign))
    different, kinds = 0, Counter[str]()
    console = Console()
    for index in track(range(runs), console=Console(stderr=True)):
        scenario = replace(drawn.scenario_of(index), duration_s=duration_s)
        kinds.update(fault.kind for fault in scenario.faults)
        for precision in ("float64", "float32"):
            chosen = replace(scenario, design=replace(scenario.design, precision=precision))
            logs = {
                name: log_of(chosen, name)
                for name in CONTROLLERS
                if (name, precision) != WITHOUT_PROMISE
            }
            for name, log in logs.items():
                if log != logs["python"]:
                    different += 1
                    console.print(f"run {index}, {precision}: {name} differs", markup=False)
    for kind, count in sorted(kinds.items()):
        console.print(f"{count:5d}  {kind}", markup=False)
    console.print(f"{different} logs differ")
    raise SystemExit(bool(different))


def log_of(scenario: Scenario, name: str) -> bytes:
    """bus.log of a run with that controller."""
    controller = controller_of(name, scenario)
    with tempfile.TemporaryDirectory() as folder:
        log, bus = Path(folder) / "bus.log", f"local:same-bytes-{os.getpid()}"
        run_in_process(scenario, bus, log, StopRequest(), lambda tick: None, controller)
        return log.read_bytes()


if __name__ == "__main__":
    main()
