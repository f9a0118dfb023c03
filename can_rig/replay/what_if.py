"""What if: the reference of a log through the closed loop of another scenario, beside the log."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

from can_rig.assessment.stability import refuse_unstable
from can_rig.cli.logs.diff import print_difference
from can_rig.cli.progress import counting
from can_rig.cli.runs.closing import closing_table
from can_rig.errors import INTERRUPTED, LogError, ScenarioError
from can_rig.nodes.lockstep import StopRequest
from can_rig.nodes.nodes import EveryNowAndThen, run_in_process
from can_rig.plant.simulated import SimulatedPlant
from can_rig.replay.source import Source, source_of
from can_rig.results.run_folder import LOG, Outcome, create, finish
from can_rig.results.signals import Signals, read_signals, signals_of
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.reference import on_the_bus
from can_rig.scenario.settings import ReferenceSettings, Scenario
from can_rig.views.diff_picture import draw_difference
from can_rig.views.run_diff import compare
from can_rig.views.signal_table import SignalTable, table_of

REFERENCE: Final = "reference.csv"
"""The log's reference, in the run folder that it leads to."""

PICTURE: Final = "what-if.png"


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
    """``can-rig replay --what-if``: the exit status.

    Raises:
        LogError: the log cannot be read, or has no reference.
        ScenarioError: a scenario that cannot run, or a reference of its own that was asked for.
        RunFolderError: the folder is there already.
    """
    for setting in settings:
        if setting.startswith("reference."):
            raise ScenarioError(f"--set {setting}: the reference of a what-if is that of the log")
    if out is not None and out.resolve() == path.resolve():
        raise LogError(f"{out}: is the log itself; another --out is right")
    recorded = source_of(path, None if path.is_dir() else name, (), channel)
    logged = _logged(recorded)
    scenario = source_of(path, name, settings).scenario
    if not any(setting.startswith("duration_s") for setting in settings):
        last_s = float(logged.time_s[-1]) + recorded.scenario.tick_s
        scenario = replace(scenario, duration_s=max(last_s, scenario.tick_s))
    network = network_of(scenario)
    controller_table(scenario, network)  # what cannot run is refused before it starts
    SimulatedPlant(scenario)
    if not allow_unstable:
        refuse_unstable(scenario)

    stop = StopRequest().on_signals()
    folder = create(out, scenario, force)
    scenario = replace(scenario, reference=_reference_file(logged, folder / REFERENCE))
    on_the_bus(scenario, network)
    with counting(scenario.name, "ticks", scenario.ticks) as on_tick:
        bus = f"local:what-if-{os.getpid()}"
        summary = run_in_process(scenario, bus, folder / LOG, stop, EveryNowAndThen(on_tick))
    outcome = Outcome(
        bus, ticks=summary.ticks, wall_s=summary.wall_s, rejected_frames=summary.rejected_frames
    )
    if summary.ticks < scenario.ticks:
        outcome.outcome = "interrupted"
    values = finish(folder, scenario, network, outcome)

    before = table_of(logged, str(path), recorded.scenario)
    asked = replace(scenario, reference=recorded.scenario.reference)  # the log's, as a file
    after = _table(folder, asked)
    difference = compare(before, after, {})
    labels = ("log", "what if")
    draw_difference(folder / PICTURE, before, after, difference)
    if as_json:
        result = {"run_folder": str(folder), "metrics": values, **difference.as_dict()}
        print(json.dumps(result, ensure_ascii=False))
    else:
        print_difference(difference, labels, before)
        Console().print()
        closing_table(scenario, network, values, outcome, folder)
    return INTERRUPTED if outcome.outcome == "interrupted" else 0


def _logged(source: Source) -> Signals:
    """The signals of the log, by the tick that it was recorded with."""
    messages = (m for frames in source.frames("reading") for m in frames.messages())
    scenario = source.scenario
    network = network_of(scenario)
    signals = signals_of(messages, network, scenario.tick_s, source.in_time_ticks)
    if not np.isfinite(signals.reference_mps2).any():
        raise LogError(f"{source.log.path}: has no reference of the rig; a log of it is right")
    return signals


def _reference_file(logged: Signals, path: Path) -> ReferenceSettings:
    """Write the logged reference where the scenario finds it; what is missing is held."""
    known = np.isfinite(logged.reference_mps2)
    first = int(np.argmax(known))
    held = np.maximum.accumulate(np.where(known, np.arange(len(known)), first))
    rows = zip(logged.time_s.tolist(), logged.reference_mps2[held].tolist(), strict=True)
    lines = [f"{time_s!r},{value!r}\n" for time_s, value in rows]
    path.write_text("time_s,reference_mps2\n" + "".join(lines), encoding="ascii")
    return ReferenceSettings(kind="csv", file=str(path))


def _table(folder: Path, scenario: Scenario) -> SignalTable:
    signals = read_signals(folder / LOG, network_of(scenario), scenario.tick_s)
    return table_of(signals, str(folder), scenario)
