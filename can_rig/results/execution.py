"""The one place that makes a run folder: for ``run``, for a what-if, for a campaign.

An existing folder stands until the new one is whole, and nothing that was recorded is lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from can_rig.assessment.speeds import refuse as refuse_unstable
from can_rig.buses.bus import in_one_process
from can_rig.errors import INTERRUPTED, BusError, RigError
from can_rig.export.controllers import PYTHON, Controller
from can_rig.files import atomic
from can_rig.folders.new_folder import NewFolder
from can_rig.folders.replacing import default_folder
from can_rig.frames.network import Network
from can_rig.nodes.agreement import is_shared, own_bus, require_alone
from can_rig.nodes.bus_access import DEFAULT_TIMEOUTS, StopRequest, Timeouts
from can_rig.nodes.clock import Progress, Throttled, no_progress
from can_rig.nodes.interaction import UNTOUCHED, Interaction
from can_rig.nodes.lockstep import require_ticks
from can_rig.nodes.processes import run_processes
from can_rig.nodes.realtime.timing import require_causal
from can_rig.nodes.runner import RunOptions, run_in_process
from can_rig.nodes.ticks import NodeSummary, RunColumns
from can_rig.nodes.without_bus import run_without_bus
from can_rig.plant.simulated import SimulatedPlant
from can_rig.results.metrics import Metrics
from can_rig.results.run_folder import LOG, REFERENCE, RUN_FOLDER, Outcome, finish
from can_rig.results.source import happened
from can_rig.scenario.build import network_of
from can_rig.scenario.driving import controls
from can_rig.scenario.reference import refuse_saturation
from can_rig.scenario.settings import ReferenceSettings, Scenario

NO_BUS: Final = "none"
"""In place of a bus's name: a run in this process, which nobody else hears."""

INTERRUPTED_RUN: Final = "interrupted"

Runner = Callable[
    [Scenario, str, Path, StopRequest, Progress, Timeouts, Controller, Interaction], NodeSummary
]


@dataclass(frozen=True)
class Execution:
    """A run that has ended, however, and left a complete folder."""

    folder: Path
    scenario: Scenario
    """As the folder says it."""
    network: Network
    outcome: Outcome
    metrics: Metrics
    happened: Scenario
    """The scenario with what was done by hand while it ran; what the metrics are of."""
    failure: RigError | None = None
    """Why it ended early, where nobody stopped it."""

    @property
    def exit_status(self) -> int:
        """Of the command that ran it."""
        if self.failure is not None:
            return self.failure.exit_status
        return INTERRUPTED if self.outcome.outcome == INTERRUPTED_RUN else 0


def in_process(
    scenario: Scenario,
    bus: str,
    log: Path,
    stop: StopRequest,
    progress: Progress,
    _timeouts: Timeouts,
    controller: Controller,
    interaction: Interaction = UNTOUCHED,
) -> NodeSummary:
    """Both nodes in this process: turn by turn on a bus, or many ticks at once without one."""
    with progress() as on_tick:
        if bus == NO_BUS and controller is PYTHON:
            return run_without_bus(scenario, log, stop, on_tick)
        summary = run_in_process(
            scenario, bus, log, stop, Throttled(on_tick), controller, interaction
        )
        on_tick(summary.ticks)
    return summary


def two_processes(
    scenario: Scenario,
    bus: str,
    log: Path,
    stop: StopRequest,
    progress: Progress,
    timeouts: Timeouts,
    controller: Controller,
    interaction: Interaction = UNTOUCHED,
) -> NodeSummary:
    """Each node in a process of its own, in lockstep."""
    return run_processes(
        scenario,
        bus,
        log,
        stop,
        progress,
        RunOptions(timeouts=timeouts, controller=controller, interaction=interaction),
    )


def real_time(
    scenario: Scenario,
    bus: str,
    log: Path,
    stop: StopRequest,
    progress: Progress,
    timeouts: Timeouts,
    controller: Controller,
    _interaction: Interaction = UNTOUCHED,
) -> NodeSummary:
    """Each node in a process of its own, by the wall clock."""
    options = RunOptions(real_time=True, timeouts=timeouts, controller=controller)
    return run_processes(scenario, bus, log, stop, progress, options)


def refuse(scenario: Scenario, allow_unstable: bool = False) -> None:
    """Refuse what cannot run before it starts.

    Raises:
        ScenarioError: no such design, plant or reference, or a loop that is not stable.
    """
    network = network_of(scenario)
    controls(scenario, network)
    refuse_saturation(scenario, network)
    SimulatedPlant(scenario)
    if not allow_unstable:
        refuse_unstable(scenario)


def execute(
    scenario: Scenario,
    out: Path | None,
    stop: StopRequest,
    *,
    force: bool = False,
    bus: str | None = None,
    runner: Runner = in_process,
    progress: Progress = no_progress,
    reference_csv: Iterable[str] | None = None,
    report: bool = True,
    timeouts: Timeouts = DEFAULT_TIMEOUTS,
    controller: Controller = PYTHON,
    interaction: Interaction = UNTOUCHED,
) -> Execution | None:
    """Run a scenario that ``refuse`` has let pass, and leave its folder.

    Args:
        scenario: the run.
        out: its folder; None: ``runs/SCENARIO-DATE-TIME``.
        stop: ends it after a tick.
        force: replace the run that is there.
        bus: name of the bus; None: in this process ``NO_BUS``, otherwise a local one of its own.
        runner: ``in_process``, ``two_processes`` or ``real_time``.
        progress: shows how far it is.
        reference_csv: a reference in place of the scenario's, in lines, kept in the
            folder as ``REFERENCE``.
        report: draw ``report.png`` too.
        timeouts: how long a node may be silent for the other.
        controller: what runs as the controller.
        interaction: how far the run can be touched.

    Returns:
        How it went; ``failure`` says why it ended early. None if it was stopped before anything
        was recorded: then there is no folder.

    Raises:
        RunFolderError: the folder is there already, or cannot be made or completed; what was
            recorded stays, and the line says where.
        RigError: it failed before anything was recorded: then there is no folder.
    """
    network = network_of(scenario)
    without = (
        runner is in_process
        and interaction == UNTOUCHED
        and _needs_no_bus(scenario, network, controller)
    )
    bus = bus or (NO_BUS if without else own_bus())
    if runner is real_time:
        require_causal(scenario)
    else:
        require_ticks(scenario, network)
    if runner is not in_process:
        _require_shared(bus)
    out = out or default_folder("runs", scenario.name)
    if bus != NO_BUS and is_shared(bus):
        require_alone(scenario, bus, network.fd)
    with NewFolder.create(out, RUN_FOLDER, force) as folder:
        try:
            made_here, said = _with_reference(scenario, folder, reference_csv)
            refuse_saturation(made_here, network)
        except RigError:
            folder.give_up()
            raise
        outcome = Outcome(bus, realtime={} if runner is real_time else None)
        columns, failure = _run(
            lambda: runner(
                made_here,
                bus,
                folder.making / LOG,
                stop,
                progress,
                timeouts,
                controller,
                interaction,
            ),
            scenario,
            outcome,
        )
        if not RUN_FOLDER.recorded(folder.making):
            folder.give_up()
            if failure is not None:
                raise failure
            return None
        try:
            if interaction.injectable:
                own = folder.making / REFERENCE
                made_here = happened(folder.making / LOG, made_here, network, own)
            values = finish(folder.making, made_here, network, outcome, said, report, columns)
            folder.publish()
        except RigError:
            if failure is not None:  # came first, and may be why: a disk that was full already
                raise failure from None
            raise
    return Execution(folder.path, said, network, outcome, values, made_here, failure)


def _needs_no_bus(scenario: Scenario, network: Network, controller: Controller) -> bool:
    """Whether a run without a bus has the same log.

    Where a fault puts other frames on the bus than those of their tick it has not.
    """
    ours = controller is PYTHON and network.is_the_rigs
    plain = not any(fault.adds_frames for fault in scenario.faults)
    return ours and plain


def _require_shared(bus: str) -> None:
    """Refuse a bus on which both nodes would wait for each other in vain."""
    if in_one_process(bus):
        raise BusError(
            f"bus {bus!r}: stays within one process, and the nodes are two; "
            "it must be the bus 'local' or another that they share, or the run --in-process"
        )


def _with_reference(
    scenario: Scenario, folder: NewFolder, csv: Iterable[str] | None
) -> tuple[Scenario, Scenario]:
    """The scenario as it runs while the folder is being made, and as the folder says it.

    Raises:
        LogError: the reference cannot be written.
    """
    if csv is None:
        return scenario, scenario
    file = folder.making / REFERENCE
    with atomic(file, force=False) as part, part.open("w", encoding="utf-8") as lines:
        lines.writelines(csv)
    made_here, said = (
        replace(scenario, reference=ReferenceSettings(kind="csv", file=str(path)))
        for path in (file, REFERENCE)
    )
    return made_here, said


def _run(
    run: Callable[[], NodeSummary], scenario: Scenario, outcome: Outcome
) -> tuple[RunColumns | None, RigError | None]:
    """Run, and note in ``outcome`` how it went; what was carried without a bus, what failed."""
    start_s = time.perf_counter()
    try:
        summary = run()
    except RigError as error:
        outcome.outcome, outcome.wall_s = str(error), time.perf_counter() - start_s
        return None, error
    outcome.ticks, outcome.wall_s = summary.ticks, summary.wall_s
    outcome.rejected_frames, outcome.bus_events = summary.rejected_frames, summary.bus_events
    outcome.realtime = summary.realtime
    if summary.ticks < scenario.ticks:
        outcome.outcome = INTERRUPTED_RUN
    return summary.columns, None
