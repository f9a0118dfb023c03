"""The only maker of run folders: for ``run`` and for a what-if.

An existing folder stands until the new folder is complete, and no recorded data are lost.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Final

from can_rig.assessment.speeds import refuse as refuse_unstable
from can_rig.buses.bus import in_one_process
from can_rig.controllers.making import controller_of, peer_of
from can_rig.controllers.protocol import InNode, Supplied
from can_rig.errors import INTERRUPTED, BusError, RigError, one_line
from can_rig.frames.network import Network
from can_rig.nodes.agreement import is_shared, own_bus, require_alone
from can_rig.nodes.bus_access import OnTick, Progress, StopRequest, Throttled, Timeouts, no_progress
from can_rig.nodes.interaction import UNTOUCHED
from can_rig.nodes.lockstep import require_ticks
from can_rig.nodes.processes import in_another_process, run_processes
from can_rig.nodes.realtime.timing import require_causal
from can_rig.nodes.runner import RunOptions, run_in_process
from can_rig.nodes.ticks import NodeSummary, RunColumns
from can_rig.nodes.without_bus import run_without_bus
from can_rig.plant.simulated import SimulatedPlant
from can_rig.results.metrics import Metrics
from can_rig.results.run_folder import LOG, REFERENCE, RUN_FOLDER, Outcome, finish
from can_rig.results.source import happened
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.reference import refuse_saturation
from can_rig.scenario.settings import ReferenceSettings, Scenario
from can_rig.storage.files import atomic
from can_rig.storage.folders import NewFolder, default_folder

NO_BUS: Final = "none"
"""In place of a bus's name: a run within this process, without listeners."""

INTERRUPTED_RUN: Final = "interrupted"


@dataclass(frozen=True)
class Execution:
    """A run that ended, for whatever reason, and left a complete folder."""

    folder: Path
    scenario: Scenario
    """The scenario as recorded in the folder."""
    network: Network
    outcome: Outcome
    metrics: Metrics
    happened: Scenario
    """The scenario with the commands given during the run; the metrics describe this scenario."""
    failure: RigError | None = None
    """The reason of an early end, unless somebody stopped the run."""

    @property
    def exit_status(self) -> int:
        """Exit status of the command."""
        if self.failure is not None:
            return self.failure.exit_status
        return INTERRUPTED if self.outcome.outcome == INTERRUPTED_RUN else 0


Runner = Callable[[Scenario, Path, StopRequest, "Options"], NodeSummary]
"""Runs a scenario and writes the log at the path; ``Options.bus`` is known."""


def in_process(scenario: Scenario, log: Path, stop: StopRequest, options: Options) -> NodeSummary:
    """Both nodes in this process: in turns on a bus, or many ticks at once without a bus."""
    bus, controller = str(options.bus), options.controller
    assert controller is not None
    with options.progress() as on_tick:
        if bus == NO_BUS and _runs_without_frames(controller):
            return run_without_bus(scenario, log, stop, on_tick)
        summary = run_in_process(
            scenario, bus, log, stop, Throttled(on_tick), controller, options.interaction
        )
        on_tick(summary.ticks)
    return summary


def two_processes(
    scenario: Scenario, log: Path, stop: StopRequest, options: Options
) -> NodeSummary:
    """Each node in a process of its own."""

    def progress() -> AbstractContextManager[OnTick]:
        if options.report and not options.real_time:  # the nodes share one core, another is free
            import_module("can_rig.results.report.page")
        return options.progress()

    return run_processes(scenario, str(options.bus), log, stop, options, progress)


@dataclass(frozen=True)
class Options(RunOptions):
    """The way to execute a run.

    Attributes:
        force: replace an existing run.
        bus: name of the bus; None: ``NO_BUS`` in this process, otherwise a new local bus.
        runner: ``in_process`` or ``two_processes``.
        reference_csv: lines of a reference that replaces the scenario's; stored in the folder as
            ``REFERENCE``.
        report: also draw the reports.
    """

    force: bool = False
    bus: str | None = None
    runner: Runner = in_process
    progress: Progress = no_progress
    reference_csv: Iterable[str] | None = None
    report: bool = True


def refuse(
    scenario: Scenario,
    allow_unstable: bool = False,
    on_answer: Callable[[int], None] = lambda number: None,
) -> None:
    """Refuse an impossible run before the start.

    ``on_answer`` is called after each answer of a controller of one's own, with its number.

    Raises:
        ScenarioError: an impossible design, plant or reference, or an unstable loop.
    """
    network = network_of(scenario)
    if scenario.controller.is_ours:
        controls(scenario, network)
    else:
        peer_of(scenario)
    refuse_saturation(scenario, network)
    SimulatedPlant(scenario)
    if not allow_unstable:
        refuse_unstable(scenario, on_answer)


def refuse_from_outside(
    scenario: Scenario, allow_unstable: bool, stop: StopRequest, silence_s: float = Timeouts.first_s
) -> None:
    """``refuse`` a scenario with ``own_code`` in another process, which that code may end.

    Raises:
        SilentNodeError: the code ended the process, or did not answer for ``silence_s``.
        ScenarioError: see ``refuse``.
    """
    if not scenario.controller.is_own:
        silence_s = math.inf  # a plant tells of no step
    check = partial(refuse, scenario, allow_unstable)
    in_another_process(check, " and ".join(scenario.own_code), stop, silence_s)


def execute(
    scenario: Scenario, out: Path | None, stop: StopRequest, options: Options | None = None
) -> Execution | None:
    """Run a scenario that passed ``refuse``, and leave the run's folder.

    Args:
        scenario: the run.
        out: the folder; None: ``runs/SCENARIO-DATE-TIME``.
        stop: ends the run after a tick.
        options: the way to run; None: every default.

    Returns:
        The ended run; ``failure`` gives the reason of an early end. None, without a folder, if the
        run was stopped before the first recorded frame.

    Raises:
        RunFolderError: the folder exists, or cannot be made or completed; recorded data stay, and
            the line says where.
        RigError: a failure before the first recorded frame; no folder is left.
    """
    options = options or Options()
    controller = options.controller or controller_of("python", scenario)
    options = replace(options, controller=controller)
    network = network_of(scenario)
    runner, interaction = options.runner, options.interaction
    if options.bus is None:
        needs_bus = runner is not in_process or interaction != UNTOUCHED
        without = not needs_bus and _needs_no_bus(scenario, network, controller)
        options = replace(options, bus=NO_BUS if without else own_bus())
    bus = str(options.bus)
    if options.real_time:
        require_causal(scenario)
    else:
        require_ticks(scenario, network)
    if runner is not in_process and in_one_process(bus):
        raise BusError(
            f"bus {bus!r}: stays within one process, and the nodes are two; "
            "it must be the bus 'local' or another that they share, or the run --in-process"
        )
    out = out or default_folder("runs", scenario.name)
    if bus != NO_BUS and is_shared(bus):
        require_alone(scenario, bus)
    with NewFolder.create(out, RUN_FOLDER, options.force) as folder:
        try:
            made_here, said = _with_reference(scenario, folder, options.reference_csv)
            refuse_saturation(made_here, network)
        except RigError:
            folder.give_up()
            raise
        log = folder.making / LOG
        outcome = Outcome(bus, realtime={} if options.real_time else None)
        columns, failure = _run(lambda: runner(made_here, log, stop, options), scenario, outcome)
        if not RUN_FOLDER.recorded(folder.making):
            folder.give_up()
            if failure is not None:
                raise failure
            return None
        try:
            if interaction.injectable:
                made_here = happened(log, made_here, network, folder.making / REFERENCE)
            values = finish(
                folder.making, made_here, network, outcome, said, options.report, columns
            )
            folder.publish()
        except RigError:
            if failure is not None:  # earlier, and perhaps the cause: an already full disk
                failure.args = (f"{failure}; what was recorded is in {log}",)
                raise failure from None
            raise
    return Execution(folder.path, said, network, outcome, values, made_here, failure)


def _runs_without_frames(controller: Supplied) -> bool:
    return isinstance(controller, InNode) and controller.without_frames


def _needs_no_bus(scenario: Scenario, network: Network, controller: Supplied) -> bool:
    """Whether a run without a bus has the same log: every tick has the same frames."""
    alike = _runs_without_frames(controller) and network.is_the_rigs
    return alike and not any(fault.needs_a_bus for fault in scenario.faults)


def _with_reference(
    scenario: Scenario, folder: NewFolder, csv: Iterable[str] | None
) -> tuple[Scenario, Scenario]:
    """The scenario while the folder is being made, and the scenario as recorded in the folder.

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
    """Run, and complete ``outcome``; return the data of a run without a bus, and the failure."""
    start_s = time.perf_counter()
    try:
        summary = run()
    except (RigError, OSError) as error:  # of the system: too many open files, for one
        failure = error if isinstance(error, RigError) else RigError(one_line(error))
        outcome.outcome, outcome.wall_s = str(failure), time.perf_counter() - start_s
        return None, failure
    outcome.ticks, outcome.wall_s = summary.ticks, summary.wall_s
    outcome.rejected_frames, outcome.bus_events = summary.rejected_frames, summary.bus_events
    outcome.realtime = summary.realtime
    if summary.ticks < scenario.ticks:
        outcome.outcome = INTERRUPTED_RUN
    return summary.columns, None
