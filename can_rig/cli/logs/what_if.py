"""``can-rig replay --what-if``: what is printed of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from can_rig.cli.logs.diff import print_difference
from can_rig.cli.output import json_line, say
from can_rig.cli.progress import counting, reading
from can_rig.cli.runs.closing import closing_table
from can_rig.errors import INTERRUPTED
from can_rig.logs.log import Window
from can_rig.nodes.bus_access import StopRequest
from can_rig.replay.what_if import LABELS, question, what_if


def what_if_command(
    path: Path,
    name: str | None,
    settings: Sequence[str],
    channel: str | None,
    window: Window,
    out: Path | None,
    force: bool,
    allow_unstable: bool,
    as_json: bool,
) -> int:
    """Answer, and print what differs: the exit status."""
    asked = question(path, name, settings, channel, lambda log: reading(log, "reading"), window)
    found = what_if(
        asked,
        out,
        StopRequest().on_signals(),
        force=force,
        allow_unstable=allow_unstable,
        progress=lambda: counting(asked.scenario.name, "ticks", asked.scenario.ticks),
    )
    if found is None:
        return INTERRUPTED
    run = found.execution
    if as_json:
        json_line(run_folder=str(run.folder), metrics=run.metrics, **found.difference.as_dict())
    else:
        print_difference(found.difference, LABELS, found.before)
        say("")
        closing_table(run.happened, run.metrics, run.outcome, run.folder)
    if run.failure is not None:
        raise run.failure
    return run.exit_status
