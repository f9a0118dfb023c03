"""``can-rig replay --what-if``: what is printed of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from can_rig.cli.diff_command import print_difference
from can_rig.cli.node_commands import tick_progress
from can_rig.cli.progress import reading
from can_rig.cli.run_command import closing_table
from can_rig.errors import INTERRUPTED
from can_rig.nodes.watchdog import StopRequest
from can_rig.replay.what_if import LABELS, question, what_if
from can_rig.views.signal_table import units_of


def what_if_command(
    path: Path,
    name: str | None,
    settings: Sequence[str],
    channel: str | None,
    out: Path | None,
    force: bool,
    allow_unstable: bool,
    as_json: bool,
) -> int:
    """Answer, and print what differs: the exit status."""
    asked = question(path, name, settings, channel, lambda log: reading(log, "reading"))
    stop = StopRequest().on_signals()
    found = what_if(
        asked,
        out,
        stop,
        force=force,
        allow_unstable=allow_unstable,
        progress=lambda: tick_progress(asked.scenario),
    )
    if found is None:
        return INTERRUPTED
    run = found.execution
    if as_json:
        result = {
            "run_folder": str(run.folder),
            "metrics": run.metrics,
            **found.difference.as_dict(),
        }
        print(json.dumps(result, ensure_ascii=False))
    else:
        print_difference(found.difference, LABELS, units_of(run.network))
        Console().print()
        closing_table(run.scenario, run.network, run.metrics, run.outcome, run.folder)
    if run.failure is not None:
        raise run.failure
    return run.exit_status
