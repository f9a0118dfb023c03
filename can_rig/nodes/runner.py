"""A node from start to end: bus, log, watchdog, and final summary."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Literal, NamedTuple

from can_rig.buses.bus import open_for_node
from can_rig.buses.local.bus import LocalBus
from can_rig.controllers.protocol import Supplied, WholeNode
from can_rig.frames import operator_frames
from can_rig.frames.comparison_frames import SENDERS, ComparisonFrame
from can_rig.nodes.agreement import Agreement, is_shared
from can_rig.nodes.bus_access import (
    DEFAULT_TIMEOUTS,
    SYSTEM_CLOCK,
    NodeBus,
    OnTick,
    PersistentSender,
    Send,
    StopRequest,
    Timeouts,
    TolerantBus,
    Watchdog,
    bus_events,
)
from can_rig.nodes.interaction import UNTOUCHED, Interaction
from can_rig.nodes.lockstep import (
    ControllerNode,
    EcuNode,
    PlantNode,
    in_real_time,
    lockstep_controller,
)
from can_rig.nodes.operating import OperatedBus
from can_rig.nodes.realtime.controller_node import RealTimeControllerNode, warm_up
from can_rig.nodes.realtime.plant_node import RealTimePlantNode
from can_rig.nodes.recording import LaterFile, LogFile, PlantRecorder, Recorder, is_stream
from can_rig.nodes.scheduling import preferred, undisturbed
from can_rig.nodes.ticks import NodeSummary, timed
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

NodeName = Literal["plant", "controller"]

CORES: Final = {"plant": 0, "controller": 1}
"""Counted from the last: the first ones serve interrupts."""


@dataclass(frozen=True)
class RunOptions:
    """How the nodes of a run are carried."""

    real_time: bool = False
    """By the wall clock instead of lockstep."""
    by_hand: bool = False
    """Another process started the other node, so both nodes compare scenarios."""
    shared: bool = False
    """A rig on a bus that others can join, whose questions are answered."""
    timeouts: Timeouts = DEFAULT_TIMEOUTS
    """Longest permitted silence of the other node."""
    controller: Supplied | None = None
    """The controller; None: of a plant node alone."""
    interaction: Interaction = UNTOUCHED
    """Permitted commands during a lockstep run."""

    @property
    def bursts(self) -> bool:
        """Whether both nodes are of this kind, and nothing changes their frames during the run."""
        touched = self.interaction.injectable or self.interaction.told
        return not (
            self.real_time or self.by_hand or touched or isinstance(self.controller, WholeNode)
        )


def run_plant(
    scenario: Scenario,
    bus_name: str,
    log: Path | None,
    stop: StopRequest,
    on_tick: OnTick,
    options: RunOptions,
) -> NodeSummary:
    """The plant node from start to end.

    Args:
        scenario: the run.
        bus_name: a name for ``open_bus``.
        log: path of the log; None records nothing.
        stop: ends the node after a tick.
        on_tick: called with the number of ticks completed.
        options: of the run.

    Raises:
        ScenarioError: an impossible scenario, or a scenario different from the controller node's.
        SilentNodeError, BusLostError: the other node or the bus is silent.
        RunFolderError: the log cannot be written.
    """
    network = network_of(scenario)
    with (
        _open(bus_name, scenario, "plant", log is not None, options) as opened,
        ExitStack() as stack,
    ):
        access = _access(opened, options)
        recorder, reports = None, None
        if log is not None:
            kind = LaterFile if options.real_time else LogFile
            recorder = stack.enter_context(Recorder(log, kind))
            if not is_stream(log):
                reports = stack.enter_context(PlantRecorder(log, kind))
        node: PlantNode | RealTimePlantNode
        if options.real_time:
            node = RealTimePlantNode(scenario, network, access.bus, recorder, SYSTEM_CLOCK, reports)
        else:
            node = PlantNode(
                scenario, network, access.send, recorder, reports, options.interaction,
                local=access.local,
            )  # fmt: skip

        def while_alone() -> None:
            if options.by_hand and isinstance(opened, Agreement):
                opened.announce()
            node.repeat()

        def completed(tick: int) -> None:
            if isinstance(opened, Agreement):
                opened.settled = True  # from now on no controller ends this node
            on_tick(tick)

        watchdog = Watchdog(access.bus, "controller", options.timeouts, stop, while_alone)
        summary = _run("plant", node, watchdog, completed, options)
        if isinstance(node, PlantNode):
            node.record_the_rest(opened, SYSTEM_CLOCK)
        else:
            summary.realtime = {**node.realtime(), **(summary.realtime or {})}
        summary.bus_events = bus_events("plant", opened, watchdog.errors, access.errors)
    return summary


def run_controller(
    scenario: Scenario,
    bus_name: str,
    stop: StopRequest,
    on_ready: Callable[[], None],
    on_tick: OnTick,
    options: RunOptions,
) -> NodeSummary:
    """The controller node from start to end; ``on_ready`` is called when listening begins.

    Other arguments and errors are as in ``run_plant``.
    """
    network, controller = network_of(scenario), options.controller
    assert controller is not None
    if options.real_time:
        warm_up(scenario, network, in_real_time(controller))
    with _open(bus_name, scenario, "controller", False, options) as opened, ExitStack() as stack:
        if isinstance(opened, Agreement) and not (options.real_time or opened.settled):
            opened.listen((network.command_1, network.command_2, network.status))
        access = _access(opened, options)
        node: ControllerNode | EcuNode | RealTimeControllerNode
        if options.real_time:
            node = RealTimeControllerNode(
                scenario, network, access.bus, SYSTEM_CLOCK, in_real_time(controller)
            )
        else:
            node = stack.enter_context(
                lockstep_controller(scenario, network, access.send, controller, access.local)
            )
        watchdog = Watchdog(access.bus, "plant", options.timeouts, stop)
        on_ready()
        summary = _run("controller", node, watchdog, on_tick, options)
        summary.bus_events = bus_events("controller", opened, watchdog.errors, access.errors)
    return summary


def run_in_process(
    scenario: Scenario,
    bus_name: str,
    log: Path,
    stop: StopRequest,
    on_tick: OnTick,
    controller: Supplied,
    interaction: Interaction = UNTOUCHED,
) -> NodeSummary:
    """Run both nodes in turns on one thread; the log equals two processes' log, byte for byte."""
    network = network_of(scenario)
    timeouts = Timeouts(first_s=Timeouts.silence_s)  # the other node is there already
    options = RunOptions(
        shared=is_shared(bus_name),
        timeouts=timeouts,
        controller=controller,
        interaction=interaction,
    )
    with (
        _open(bus_name, scenario, "plant", True, options) as plant_bus,
        _open(bus_name, scenario, "controller", False, RunOptions()) as controller_bus,
        Recorder(log) as recorder,
        PlantRecorder(log) as reports,
        ExitStack() as stack,
    ):
        heard: NodeBus = plant_bus
        if interaction.told:
            heard = OperatedBus(plant_bus, network, interaction.told)
        plants, controllers = (_access(bus, options) for bus in (heard, controller_bus))
        plant = PlantNode(
            scenario, network, plants.send, recorder, reports, interaction, local=plants.local
        )
        other = stack.enter_context(
            lockstep_controller(scenario, network, controllers.send, controller, controllers.local)
        )
        never = StopRequest()  # a stop is read between ticks here, so every tick completes
        to_plant = Watchdog(heard, "controller", timeouts, never)
        to_controller = Watchdog(controller_bus, "plant", timeouts, never)
        answer = partial(other.serve, to_controller)

        def carry(tick: int) -> int:
            stop.require_none()
            return plant.carry(to_plant, tick, answer)

        summary = timed(carry, scenario.ticks, on_tick)
        plant.record_the_rest(plant_bus, SYSTEM_CLOCK)
        summary.rejected_frames = plant.rejected() | other.rejected()
        summary.bus_events = bus_events("plant", plant_bus, to_plant.errors, plants.errors)
        summary.bus_events |= bus_events(
            "controller", controller_bus, to_controller.errors, controllers.errors
        )
    return summary


class Access(NamedTuple):
    """The bus interface of a node."""

    bus: NodeBus
    send: Send
    errors: Counter[str]
    """What it refused, and how often."""
    local: LocalBus | None
    """The bus for frames as bursts; None: frame by frame."""


def _access(opened: NodeBus, options: RunOptions) -> Access:
    """Lockstep retries refused frames until the bus accepts; real time drops refused frames."""
    if options.real_time:
        tolerant = TolerantBus(opened, SYSTEM_CLOCK)
        return Access(tolerant, tolerant.send, tolerant.errors, None)
    silence_s = options.timeouts.silence_s  # unlimited for a paused partner, not for a bus
    patience_s = silence_s if silence_s < math.inf else DEFAULT_TIMEOUTS.silence_s
    sender = PersistentSender(opened, patience_s, SYSTEM_CLOCK)
    inner = opened.bus if isinstance(opened, Agreement) else opened
    local = inner if isinstance(inner, LocalBus) and options.bursts else None
    return Access(opened, sender, sender.errors, local)


@contextmanager
def _open(
    bus_name: str, scenario: Scenario, node: NodeName, overhear: bool, options: RunOptions
) -> Iterator[NodeBus]:
    """The bus, with the comparison on it for a node that others can join."""
    network, compares = network_of(scenario), options.by_hand or options.shared
    extra = [operator_frames.identifiers().taken] if node == "controller" else []
    extra += [ComparisonFrame(each).frame_id for each in SENDERS] if compares else []
    with open_for_node(bus_name, (*network.identifiers, *extra), overhear, network.fd) as bus:
        if not compares:
            yield bus
            return
        agreement = Agreement(scenario, node, bus, SYSTEM_CLOCK)
        if options.by_hand:
            agreement.announce()
        agreement.settled = not options.by_hand  # a rig has asked before, and goes on
        yield agreement


def _run(
    name: NodeName,
    node: PlantNode | ControllerNode | EcuNode | RealTimePlantNode | RealTimeControllerNode,
    watchdog: Watchdog,
    on_tick: OnTick,
    options: RunOptions,
) -> NodeSummary:
    """Run the node's loop with the required process settings."""
    carry, of_clock = partial(node.carry, watchdog), options.real_time
    with preferred(CORES[name]) if of_clock else nullcontext("") as scheduling:
        summary = timed(carry, node.ticks, on_tick, undisturbed() if of_clock else None)
    summary.rejected_frames = node.rejected()
    summary.realtime = {"scheduling": {name: scheduling}} if of_clock else None
    return summary
