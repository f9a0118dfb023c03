"""One node as a process: bus, watchdog, stop signals, progress, summary."""

from __future__ import annotations

import gc
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

from can_rig.bus import open_bus
from can_rig.controller_node import ControllerNode
from can_rig.lockstep import Interrupted, Patience, StopRequest, Waiting
from can_rig.messages import Network, load_network
from can_rig.plant_node import PlantNode
from can_rig.recorder import Recorder
from can_rig.scenario import Scenario

NodeName = Literal["plant", "controller"]
PROGRESS_EVERY_S = 0.1


@dataclass
class NodeSummary:
    """What a node says when it ends."""

    ticks: int
    wall_s: float
    rejected_frames: dict[str, dict[str, int]]


def network_of(scenario: Scenario) -> Network:
    """The scenario's frames, from the DBC that comes with the package or lies in the checkout."""
    package = Path(str(files("can_rig")))
    folder = package / "dbc" if (package / "dbc").is_dir() else package.parent / "dbc"
    return load_network(folder / scenario.dbc)


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
    with open_bus(bus_name) as bus, _recorder(log, scenario) as recorder:
        node = PlantNode(scenario, network, bus, recorder)
        patience = Patience(bus, "controller", waiting, stop, while_alone=node.repeat)
        with without_garbage_pauses():
            start = time.perf_counter()
            ticks = node.run(patience, on_tick)
            wall_s = time.perf_counter() - start
    return NodeSummary(ticks, wall_s, node.rejected())


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
    with open_bus(bus_name) as bus:
        node = ControllerNode(scenario, network, bus)
        patience = Patience(bus, "plant", waiting, stop)
        on_ready()
        with without_garbage_pauses():
            start = time.perf_counter()
            ticks = node.run(patience, on_tick)
            wall_s = time.perf_counter() - start
    return NodeSummary(ticks, wall_s, node.rejected())


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
        open_bus(bus_name) as plant_bus,
        open_bus(bus_name) as controller_bus,
        Recorder(log, scenario.tick_ns) as recorder,
    ):
        plant = PlantNode(scenario, network, plant_bus, recorder)
        controller = ControllerNode(scenario, network, controller_bus)
        to_plant = Patience(plant_bus, "controller", waiting, stop)
        to_controller = Patience(controller_bus, "plant", waiting, stop)
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
    return NodeSummary(tick, wall_s, plant.rejected() | controller.rejected())


@contextmanager
def _recorder(log: Path | None, scenario: Scenario) -> Iterator[Recorder | None]:
    if log is None:
        yield None
        return
    with Recorder(log, scenario.tick_ns) as recorder:
        yield recorder


class EveryNowAndThen:
    """Calls ``report(tick)`` at most every 0.1 s; asked each tick, it looks at the clock rarely."""

    def __init__(self, report: Callable[[int], None]) -> None:
        self._report = report
        self._countdown = self._stride = 64
        self._last_s = time.monotonic()

    def __call__(self, tick: int) -> None:
        """Note that ``tick`` ticks are done."""
        self._countdown -= 1
        if self._countdown:
            return
        self._countdown = self._stride
        now_s = time.monotonic()
        if now_s - self._last_s >= PROGRESS_EVERY_S:
            self._last_s = now_s
            self._report(tick)


def json_line(**values: object) -> None:
    """One line of JSON on standard output, at once: how a node talks to ``can-rig run``."""
    print(json.dumps(values), flush=True)
