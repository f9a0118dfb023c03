"""One node as a process: bus, watchdog, stop signals, progress, summary."""

from __future__ import annotations

import gc
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import can

from can_rig.buses.bus import open_for_node
from can_rig.nodes.controller_node import ControllerNode
from can_rig.nodes.lockstep import Interrupted, Sender, StopRequest, Waiting, Watchdog
from can_rig.nodes.plant_node import PlantNode
from can_rig.nodes.recorder import Recorder
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

NodeName = Literal["plant", "controller"]


@dataclass
class NodeSummary:
    """What a node says when it ends."""

    ticks: int
    wall_s: float
    rejected_frames: dict[str, dict[str, int]]
    """Of each message, how many were not used, by reason."""
    bus_events: dict[str, dict[str, int]]
    """Of each node, what its bus refused, failed or dropped, and how often; only what occurred."""
    realtime: dict[str, Any] | None = None
    """How deadlines were met and what the system permitted; None in lockstep."""


@contextmanager
def without_garbage_pauses() -> Iterator[None]:
    """Keep the collector away from what was set up before the loop."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def run_plant(
    scenario: Scenario,
    bus_name: str,
    log: Path | None,
    waiting: Waiting,
    stop: StopRequest,
    on_tick: Callable[[int], None],
) -> NodeSummary:
    """The plant node from start to end; see ``PlantNode`` for what it raises."""
    network = network_of(scenario)
    with (
        open_for_node(bus_name, network.identifiers, overhear=log is not None) as bus,
        _recorder(log, scenario) as recorder,
    ):
        node = PlantNode(scenario, network, bus, recorder, waiting)
        watchdog = Watchdog(bus, "controller", waiting, stop, while_alone=node.repeat)
        with without_garbage_pauses():
            start = time.perf_counter()
            ticks = node.run(watchdog, on_tick)
            wall_s = time.perf_counter() - start
        node.record_the_rest()
        events = bus_events("plant", bus, node.send, watchdog)
    return NodeSummary(ticks, wall_s, node.rejected(), events)


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
    with open_for_node(bus_name, network.identifiers, overhear=False) as bus:
        node = ControllerNode(scenario, network, bus, waiting)
        watchdog = Watchdog(bus, "plant", waiting, stop)
        on_ready()
        with without_garbage_pauses():
            start = time.perf_counter()
            ticks = node.run(watchdog, on_tick)
            wall_s = time.perf_counter() - start
        events = bus_events("controller", bus, node.send, watchdog)
    return NodeSummary(ticks, wall_s, node.rejected(), events)


def run_in_process(
    scenario: Scenario,
    bus_name: str,
    log: Path,
    stop: StopRequest,
    on_tick: Callable[[int], None],
) -> NodeSummary:
    """Both nodes on one thread, turn by turn; the log is that of two processes, byte for byte."""
    network = network_of(scenario)
    waiting = Waiting()
    with (
        open_for_node(bus_name, network.identifiers, overhear=True) as plant_bus,
        open_for_node(bus_name, network.identifiers, overhear=False) as controller_bus,
        Recorder(log, scenario.tick_ns) as recorder,
    ):
        plant = PlantNode(scenario, network, plant_bus, recorder)
        controller = ControllerNode(scenario, network, controller_bus)
        to_plant = Watchdog(plant_bus, "controller", waiting, stop)
        to_controller = Watchdog(controller_bus, "plant", waiting, stop)
        with without_garbage_pauses():
            start = time.perf_counter()
            tick = 0
            with suppress(Interrupted):
                while tick < scenario.ticks and not stop.wanted:
                    plant.offer(tick)
                    controller.serve(to_controller)
                    plant.collect(tick, to_plant)
                    tick += 1
                    on_tick(tick)
            wall_s = time.perf_counter() - start
        plant.record_the_rest()
        events = bus_events("plant", plant_bus, plant.send, to_plant)
        events |= bus_events("controller", controller_bus, controller.send, to_controller)
    return NodeSummary(tick, wall_s, plant.rejected() | controller.rejected(), events)


def bus_events(
    node: NodeName, bus: can.BusABC, send: Sender, watchdog: Watchdog
) -> dict[str, dict[str, int]]:
    """What the bus of one node did beside carrying frames."""
    counts = Counter(watchdog.errors)
    for errors in (send.errors, getattr(bus, "errors", {})):
        counts.update(errors)
    counts["frames dropped unread"] = getattr(bus, "lost_frames", 0)
    counts = +counts  # without zeros
    return {node: dict(counts)} if counts else {}


@contextmanager
def _recorder(log: Path | None, scenario: Scenario) -> Iterator[Recorder | None]:
    if log is None:
        yield None
        return
    with Recorder(log, scenario.tick_ns) as recorder:
        yield recorder


def json_line(**values: object) -> None:
    """One line of JSON on standard output, at once: how a node talks to ``can-rig run``."""
    print(json.dumps(values), flush=True)
