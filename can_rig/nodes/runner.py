"""A node from start to end: bus, log, watchdog, and final summary."""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from can_rig.buses.bus import open_for_node
from can_rig.export.controllers import PYTHON, Controller
from can_rig.frames import operator_frames
from can_rig.frames.comparison_frames import SENDERS, ComparisonFrame
from can_rig.nodes.agreement import Agreement, is_shared
from can_rig.nodes.bus_access import (
    NodeBus,
    PersistentSender,
    Send,
    StopRequest,
    Timeouts,
    TolerantBus,
    Watchdog,
    bus_events,
)
from can_rig.nodes.clock import NS_PER_S, SYSTEM_CLOCK, Clock, OnTick, Pace
from can_rig.nodes.interaction import UNTOUCHED, Interaction
from can_rig.nodes.lockstep import (
    ControllerNode,
    EcuNode,
    PlantNode,
    in_real_time,
    lockstep_controller,
)
from can_rig.nodes.realtime.controller_node import RealTimeControllerNode, warm_up
from can_rig.nodes.realtime.plant_node import RealTimePlantNode
from can_rig.nodes.recorded_commands import OperatedBus
from can_rig.nodes.recording import PlantRecorder, RealTimeRecorder, Recorder, is_stream
from can_rig.nodes.scheduling import prefer, undisturbed
from can_rig.nodes.summary import NodeSummary
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

NodeName = Literal["plant", "controller"]

PLANT_CORE, CONTROLLER_CORE = 0, 1  # counted from the last: the first ones serve interrupts


def run_plant(
    scenario: Scenario,
    bus_name: str,
    log: Path | None,
    timeouts: Timeouts,
    stop: StopRequest,
    on_tick: OnTick,
    *,
    real_time: bool = False,
    by_hand: bool = False,
    shared: bool = False,
    interaction: Interaction = UNTOUCHED,
) -> NodeSummary:
    """The plant node from start to end.

    Args:
        scenario: the run.
        bus_name: a name for ``open_bus``.
        log: path of the log; None records nothing.
        timeouts: longest permitted silence of the controller node.
        stop: ends the node after a tick.
        on_tick: called with the number of ticks completed.
        real_time: by the wall clock instead of lockstep.
        by_hand: another process started the other node, so both nodes compare scenarios.
        shared: of a rig on a bus that others can join, whose questions are answered.
        interaction: permitted commands during a lockstep run.

    Raises:
        ScenarioError: an impossible scenario, or a scenario different from the controller node's.
        SilentNodeError, BusLostError: the other node or the bus is silent.
        RunFolderError: the log cannot be written.
    """
    network, clock = network_of(scenario), SYSTEM_CLOCK
    with (
        _open(bus_name, scenario, "plant", by_hand, log is not None, shared) as opened,
        ExitStack() as stack,
    ):
        access = _access(opened, real_time, timeouts, clock)
        live, recorder, reports = None, None, None
        if log is not None:
            if real_time:
                live = stack.enter_context(RealTimeRecorder(log))
            else:
                recorder = stack.enter_context(Recorder(log, scenario.tick_ns))
            if not is_stream(log):
                reports = stack.enter_context(PlantRecorder(log))
        node: PlantNode | RealTimePlantNode
        if real_time:
            node = RealTimePlantNode(scenario, network, access.bus, live, clock, reports)
        else:
            node = PlantNode(scenario, network, access.send, recorder, reports, interaction)

        def while_alone() -> None:
            if by_hand and isinstance(opened, Agreement):
                opened.announce()
            node.repeat()

        def completed(tick: int) -> None:
            if isinstance(opened, Agreement):
                opened.settled = True  # from now on no controller ends this node
            on_tick(tick)

        watchdog = Watchdog(access.bus, "controller", timeouts, stop, while_alone, clock)
        summary = _run("plant", node, watchdog, completed, access, PLANT_CORE, clock)
        if isinstance(node, PlantNode):
            node.record_the_rest(opened, clock)
        else:
            summary.realtime = {**node.realtime(), **(summary.realtime or {})}
        summary.bus_events = bus_events("plant", opened, watchdog.errors, access.errors)
    return summary


def run_controller(
    scenario: Scenario,
    bus_name: str,
    timeouts: Timeouts,
    stop: StopRequest,
    on_ready: Callable[[], None],
    on_tick: OnTick,
    *,
    real_time: bool = False,
    by_hand: bool = False,
    controller: Controller = PYTHON,
) -> NodeSummary:
    """The controller node from start to end; ``on_ready`` is called when listening begins.

    ``controller`` is the implementation; other arguments and errors are as in ``run_plant``.
    """
    network, clock = network_of(scenario), SYSTEM_CLOCK
    if real_time:
        warm_up(scenario, network)
    with (
        _open(bus_name, scenario, "controller", by_hand, overhear=False) as opened,
        ExitStack() as stack,
    ):
        access = _access(opened, real_time, timeouts, clock)
        node: ControllerNode | EcuNode | RealTimeControllerNode
        if real_time:
            law = in_real_time(controller)
            node = RealTimeControllerNode(scenario, network, access.bus, clock, law)
        else:
            node = stack.enter_context(
                lockstep_controller(scenario, network, access.send, controller)
            )
        watchdog = Watchdog(access.bus, "plant", timeouts, stop, clock=clock)
        on_ready()
        summary = _run("controller", node, watchdog, on_tick, access, CONTROLLER_CORE, clock)
        summary.bus_events = bus_events("controller", opened, watchdog.errors, access.errors)
    return summary


def run_in_process(
    scenario: Scenario,
    bus_name: str,
    log: Path,
    stop: StopRequest,
    on_tick: OnTick,
    controller: Controller = PYTHON,
    interaction: Interaction = UNTOUCHED,
) -> NodeSummary:
    """Run both nodes in turns on one thread; the log equals two processes' log, byte for byte."""
    network, clock = network_of(scenario), SYSTEM_CLOCK
    timeouts = Timeouts(first_s=Timeouts.silence_s)  # the other node is there already
    with (
        _open(bus_name, scenario, "plant", False, True, is_shared(bus_name)) as plant_bus,
        open_for_node(
            bus_name, (*network.identifiers, operator_frames.identifiers().taken), False, network.fd
        ) as controller_bus,
        Recorder(log, scenario.tick_ns) as recorder,
        PlantRecorder(log) as reports,
        ExitStack() as stack,
    ):
        heard: NodeBus = plant_bus
        if interaction.told:
            heard = OperatedBus(plant_bus, network, interaction.told)
        plant_access, controller_access = (
            _access(bus, False, timeouts, clock) for bus in (heard, controller_bus)
        )
        plant = PlantNode(scenario, network, plant_access.send, recorder, reports, interaction)
        controller_node = stack.enter_context(
            lockstep_controller(scenario, network, controller_access.send, controller)
        )
        never = StopRequest()  # a stop is read between ticks here, so every tick completes
        to_plant = Watchdog(heard, "controller", timeouts, never, clock=clock)
        to_controller = Watchdog(controller_bus, "plant", timeouts, never, clock=clock)
        with without_garbage_pauses():
            start_ns = clock.now_ns()
            tick = 0
            while tick < scenario.ticks and not stop.wanted:
                plant.begin(tick, to_plant)
                plant.offer(tick)
                controller_node.serve(to_controller)
                plant.collect(tick, to_plant)
                tick += 1
                on_tick(tick)
            wall_s = (clock.now_ns() - start_ns) / NS_PER_S
        plant.record_the_rest(plant_bus, clock)
        rejected = controller_node.rejected()
        events = bus_events("plant", plant_bus, to_plant.errors, plant_access.errors)
        events |= bus_events(
            "controller", controller_bus, to_controller.errors, controller_access.errors
        )
    return NodeSummary(tick, wall_s, plant.rejected() | rejected, events, ticks_per_s=tick / wall_s)


class Access(NamedTuple):
    """The bus interface of a node."""

    bus: NodeBus
    send: Send
    errors: Counter[str]
    """What it refused, and how often."""
    real_time: bool


def _access(opened: NodeBus, real_time: bool, timeouts: Timeouts, clock: Clock) -> Access:
    """Lockstep retries refused frames until the bus accepts; real time drops refused frames."""
    if real_time:
        tolerant = TolerantBus(opened, clock)
        return Access(tolerant, tolerant.send, tolerant.errors, real_time)
    sender = PersistentSender(opened, timeouts.silence_s, clock)
    return Access(opened, sender, sender.errors, real_time)


@contextmanager
def _open(
    bus_name: str,
    scenario: Scenario,
    node: NodeName,
    by_hand: bool,
    overhear: bool,
    shared: bool = False,
) -> Iterator[NodeBus]:
    """The bus, with the comparison on it for a node that others can join."""
    network = network_of(scenario)
    beside = [operator_frames.identifiers().taken] if node == "controller" else []
    beside += [ComparisonFrame(each).frame_id for each in SENDERS] if by_hand or shared else []
    with open_for_node(bus_name, (*network.identifiers, *beside), overhear, network.fd) as bus:
        if not (by_hand or shared):
            yield bus
            return
        agreement = Agreement(scenario, node, bus, SYSTEM_CLOCK)
        if by_hand:
            agreement.announce()
        agreement.settled = not by_hand  # a rig has asked before, and does not end any more
        yield agreement


class Node(Protocol):
    """What both nodes have in common."""

    def run(self, watchdog: Watchdog, on_tick: OnTick) -> int:
        """To the end or to a stop request; the tick that was reached."""

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""


def _run(
    name: NodeName,
    node: Node,
    watchdog: Watchdog,
    on_tick: OnTick,
    access: Access,
    core: int,
    clock: Clock,
) -> NodeSummary:
    """Run the node's loop with the required process settings."""
    pace, realtime = Pace(clock, on_tick), None
    if access.real_time:
        realtime = {"scheduling": {name: prefer(core)}}
    with undisturbed() if access.real_time else without_garbage_pauses():
        start_ns = clock.now_ns()
        ticks = node.run(watchdog, pace)
        wall_s = (clock.now_ns() - start_ns) / NS_PER_S
        rate = pace.ticks_per_s
    return NodeSummary(ticks, wall_s, node.rejected(), {}, realtime, ticks_per_s=rate)


@contextmanager
def without_garbage_pauses() -> Iterator[None]:
    """Exclude objects from before the loop from garbage collection.

    Objects stay excluded if a command has frozen its imports: unfreezing covers all frozen objects
    at once, and a search of the imports takes as long as the import.
    """
    before = gc.get_freeze_count()
    gc.freeze()
    try:
        yield
    finally:
        if before == 0:
            gc.unfreeze()
