"""Record the drives of ``tests/drives`` with today's firmware; see ``drives.toml`` there."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import click

from can_rig.controllers.our_law import PYTHON
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from tests.rig.replay.recorded import (
    DRIVES,
    are_close,
    designed,
    has_constants,
    keep,
    log_of,
    recorded,
    scenario_of,
)


@click.command()
@click.argument("names", nargs=-1)
def record(names: tuple[str, ...]) -> None:
    """Record the drives NAMES again, or all; one with the same frames and constants is left."""
    unknown = set(names) - set(DRIVES)
    if unknown:
        raise click.UsageError(f"{', '.join(sorted(unknown))}: not in drives.toml")
    for name in names or DRIVES:
        scenario, path = scenario_of(name), log_of(name)
        constants = designed(scenario)
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "bus.log"
            bus = f"local:{folder}/bus"
            run_in_process(scenario, bus, log, StopRequest(), lambda tick: None, PYTHON)
            same = path.exists() and frames(path) == frames(log)
            same = same and has_constants(name) and are_close(constants, recorded(name))
            if not same:
                write_log(read_log(log), path, force=True)
                keep(name, constants)
        said = "as it was" if same else f"recorded, {path.stat().st_size / 1000:.0f} kB"
        click.echo(f"{name:16} {scenario.ticks:6} ticks  {said}")


def frames(path: Path) -> list[tuple[object, ...]]:
    """Everything a log says."""
    return [
        (time_ns, message.arbitration_id, bytes(message.data))
        for chunk in read_log(path)
        for time_ns, message in zip(chunk.time_ns.tolist(), chunk.messages(), strict=True)
    ]


if __name__ == "__main__":
    record()
