"""One node as a process in real time: as ``nodes``, with what keeps the cyclic path undisturbed."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import cast

import can

from can_rig.buses.bus import open_for_node
from can_rig.errors import one_line
from can_rig.nodes.lockstep import RETRY_S, StopRequest, Waiting, Watchdog
from can_rig.nodes.nodes import NodeSummary, bus_events
from can_rig.nodes.realtime.controller_node import RealTimeControllerNode, warm_up
from can_rig.nodes.realtime.deadlines import MonotonicClock
from can_rig.nodes.realtime.plant_node import RealTimePlantNode
from can_rig.nodes.realtime.scheduling import prefer, undisturbed
from can_rig.nodes.recorder import RealTimeRecorder
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

PLANT_CORE, CONTROLLER_CORE = 0, 1  # counted from the last: the first ones serve interrupts


class Undeterred:
    """A bus that is never waited for: what it refuses is not sent, and counted in ``errors``.

    A frame that is sent again later belongs to a tick that is over, and an interface that is down
    may come back; a node that hears nothing meanwhile ends by its own watchdog.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self.errors: Counter[str] = Counter()

    def send(self, message: can.Message) -> None:
        """Send, or count why not."""
        try:
            self._bus.send(message)
        except can.CanError as error:
            self.errors[one_line(error)] += 1

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; None where none came or the bus failed."""
        try:
            return self._bus.recv(timeout)
        except can.CanError as error:
            self.errors[one_line(error)] += 1
            time.sleep(min(RETRY_S, timeout or 0.0))
            return None

    @property
    def lost_frames(self) -> int:
        """Frames that the bus dropped unread."""
        return int(getattr(self._bus, "lost_frames", 0))


def run_plant(
    scenario: Scenario,
    bus_name: str,
    log: Path | None,
    waiting: Waiting,
    stop: StopRequest,
    on_tick: Callable[[int], None],
) -> NodeSummary:
    """The plant node from start to end; see ``RealTimePlantNode`` for what it raises."""
    network = network_of(scenario)
    recording = RealTimeRecorder(log, scenario.tick_ns) if log is not None else nullcontext()
    with (
        open_for_node(bus_name, network.identifiers, overhear=log is not None) as opened,
        recording as recorder,
    ):
        bus = cast(can.BusABC, Undeterred(opened))  # all of it that a node uses
        node = RealTimePlantNode(scenario, network, bus, recorder, MonotonicClock())
        watchdog = Watchdog(bus, "controller", waiting, stop, while_alone=node.repeat)
        granted = prefer(PLANT_CORE)
        with undisturbed():
            start = time.perf_counter()
            ticks = node.run(watchdog, on_tick)
            wall_s = time.perf_counter() - start
        events = bus_events("plant", bus, node.send, watchdog)
    realtime = {**node.realtime(), "scheduling": {"plant": granted}}
    return NodeSummary(ticks, wall_s, node.rejected(), events, realtime)


def run_controller(
    scenario: Scenario,
    bus_name: str,
    waiting: Waiting,
    stop: StopRequest,
    on_ready: Callable[[], None],
    on_tick: Callable[[int], None],
) -> NodeSummary:
    """The controller node from start to end; ``on_ready`` is called once it listens."""
    network = network_of(scenario)
    warm_up(scenario, network)
    with open_for_node(bus_name, network.identifiers, overhear=False) as opened:
        bus = cast(can.BusABC, Undeterred(opened))  # all of it that a node uses
        node = RealTimeControllerNode(scenario, network, bus)
        watchdog = Watchdog(bus, "plant", waiting, stop)
        on_ready()
        granted = prefer(CONTROLLER_CORE)
        with undisturbed():
            start = time.perf_counter()
            ticks = node.run(watchdog, on_tick)
            wall_s = time.perf_counter() - start
        events = bus_events("controller", bus, node.send, watchdog)
    realtime = {"scheduling": {"controller": granted}}
    return NodeSummary(ticks, wall_s, node.rejected(), events, realtime)
