"""What if: the reference of a log through the closed loop of a changed scenario, and both runs."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from can_rig.errors import LogError, ScenarioError
from can_rig.logs.frames import ALL, Frames, Window
from can_rig.nodes.bus_access import Progress, StopRequest, no_progress
from can_rig.nodes.interaction import UNTOUCHED, Interaction
from can_rig.nodes.operating import Touch, Touches
from can_rig.results.execution import Execution, Options, execute, refuse
from can_rig.results.run_folder import WHAT_IF, log_of
from can_rig.results.signals import Signals, read_signals, signals_of, with_plant_signals
from can_rig.results.source import Reading, Source, reference_csv, source_of
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import ReferenceSettings, Scenario
from can_rig.storage.files import atomic
from can_rig.views.diff import Difference, compare
from can_rig.views.pictures import difference_page
from can_rig.views.signal_table import SignalTable, table_of

LABELS: Final = ("log", "what if")


@dataclass(frozen=True)
class Question:
    """A log, and a changed scenario."""

    recorded: Source
    logged: Signals
    told: tuple[Touch, ...]
    """Commands during the recorded run."""
    label: str
    """The log or run folder, as named by the user."""
    scenario: Scenario
    """The changed scenario; as long as the log, unless the user changed the duration."""


@dataclass(frozen=True)
class WhatIf:
    """The answer: a new run, and its differences from the log."""

    execution: Execution
    before: SignalTable
    """The log."""
    difference: Difference


def question(
    path: Path,
    name: str | None,
    settings: Sequence[str],
    channel: str | None = None,
    reading: Reading = iter,
    window: Window = ALL,
) -> Question:
    """Read the log and the changed scenario.

    Args:
        path: a log or a run folder.
        name: the scenario in place of the folder's own; a log needs one.
        settings: ``KEY=VALUE`` changes of it.
        channel: the only bus to read; None: all buses.
        reading: iterates over the log and shows the progress.
        window: the part of the log to read.

    Raises:
        LogError: the log cannot be read, or has no reference.
        ScenarioError: no scenario, or a change of the reference.
    """
    for setting in settings:
        if setting.startswith("reference."):
            raise ScenarioError(f"--set {setting}: the reference of a what-if is that of the log")
    recorded = source_of(path, None if path.is_dir() else name, (), channel, window)
    told = Touches(network_of(recorded.scenario))
    logged = _logged(recorded, told.watching(recorded.frames(reading)))
    scenario = source_of(path, name, settings).scenario
    if not any(setting.startswith("duration_s") for setting in settings):
        last_s = float(logged.time_s[-1]) + recorded.scenario.tick_s
        scenario = replace(scenario, duration_s=max(last_s, scenario.tick_s))
    return Question(recorded, logged, tuple(told.found), str(path), scenario)


def what_if(
    asked: Question,
    out: Path | None,
    stop: StopRequest,
    *,
    force: bool = False,
    allow_unstable: bool = False,
    progress: Progress = no_progress,
) -> WhatIf | None:
    """Run the scenario with the reference of the log, in this process.

    Args:
        asked: the log and the scenario.
        out: the folder of the run; see ``execute``.
        stop: ends the run after a tick.
        force: replace the run that is there.
        allow_unstable: run an unstable loop too.
        progress: shows the progress.

    Returns:
        The answer; None if stopped before the first recorded frame.

    Raises:
        LogError: the folder is the log itself.
        ScenarioError: an impossible run.
        RunFolderError: see ``execute``.
    """
    log = asked.recorded.log.path
    if out is not None and out.resolve() in (log.resolve(), log.parent.resolve()):
        raise LogError(f"{out}: is the log itself; choose another --out")
    reference = reference_csv(asked.logged)
    refuse(replace(asked.scenario, reference=ReferenceSettings()), allow_unstable)
    options = Options(
        force=force,
        progress=progress,
        reference_csv=reference,
        interaction=Interaction(injectable=True, told=asked.told) if asked.told else UNTOUCHED,
    )
    execution = execute(asked.scenario, out, stop, options)
    if execution is None:
        return None
    network, scenario = execution.network, execution.scenario
    signals = read_signals(log_of(execution.folder), network, scenario.tick_s)
    if not asked.logged.plant:  # absent from a log without run folder
        signals = replace(signals, plant={})
    before = table_of(asked.logged, asked.label, asked.recorded.scenario)
    same_reference = replace(scenario, reference=asked.recorded.scenario.reference)
    after = table_of(signals, LABELS[1], same_reference)  # the log's reference, as a file
    difference = compare(before, after, {})
    with atomic(execution.folder / WHAT_IF, force=True) as part:
        difference_page(before, after, difference).savefig(part, dpi=150)
    return WhatIf(execution, before, difference)


def _logged(source: Source, chunks: Iterable[Frames]) -> Signals:
    """The signals of the log, with the recorded tick."""
    scenario = source.scenario
    network = network_of(scenario)
    signals = signals_of(chunks, network, scenario.tick_s, source.in_time_ticks)
    if not np.isfinite(signals.reference_mps2).any():
        raise LogError(f"{source.log.path}: has no reference of the rig; it must be a log of it")
    return with_plant_signals(signals, source.log.path, scenario.tick_s)
