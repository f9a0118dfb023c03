"""Both nodes without a bus: many ticks compiled, then all their frames at once.

What is recorded is what the two nodes record in lockstep, byte for byte.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np

from can_rig.frames.frame_columns import payloads
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.clock import NS_PER_S, SYSTEM_CLOCK, OnTick
from can_rig.nodes.recording import LogFile, PlantRecorder, candump_bytes
from can_rig.nodes.summary import NodeSummary, RunColumns
from can_rig.plant.behind import LinearBehind, PlantBehind
from can_rig.plant.changing_car import plant_of
from can_rig.plant.faults.delivery import delivery
from can_rig.plant.frameless import inputs_of, simulation
from can_rig.scenario.build import network_of
from can_rig.scenario.driving import controls
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Simulation
from firmware_model.target.structs import FloatArray

BLOCK_TICKS: Final = 8192
"""Between two looks at whether to stop; what is done is on disk by then."""


def run_without_bus(
    scenario: Scenario, log: Path, stop: StopRequest, on_tick: OnTick
) -> NodeSummary:
    """Both nodes and no bus; the log is that of two processes, byte for byte."""
    run = RunWithoutBus(scenario, log)
    wall_s = run.run(stop, on_tick)
    rate = run.ticks / wall_s
    return NodeSummary(run.ticks, wall_s, run.rejected(), {}, None, run.columns, rate)


class RunWithoutBus:
    """A scenario, recorded as it goes on.

    Args:
        scenario: the run.
        log: where to record.

    Raises:
        ScenarioError: a scenario that cannot run.
        RunFolderError: the log cannot be written.
    """

    def __init__(self, scenario: Scenario, log: Path) -> None:
        self._scenario = scenario
        self._network: Network = network_of(scenario)
        inputs = inputs_of(scenario, self._network)
        self._speed = inputs.speed
        self._delivery = inputs.delivery
        self._files = ExitStack()
        self._log = LogFile(log)
        self._files.callback(self._log.close)
        self._reports = self._files.enter_context(PlantRecorder(log))
        plant = plant_of(scenario)
        self._linear = plant if isinstance(plant, LinearBehind) else None
        self._plant: dict[str, FloatArray] = {}
        self._loop: Simulation = simulation(
            scenario,
            self._network,
            plant.sampled if isinstance(plant, LinearBehind) else _Reporting(plant, self._reports),
            controls(scenario, self._network),
            inputs,
            keeps_states=True,
        )
        self._loop.run(0)  # compiles, or loads what was compiled, before the first tick

    def run(self, stop: StopRequest, on_tick: OnTick) -> float:
        """Go on to the end or to a stop request; how long that took, s.

        Raises:
            RigError: a plant of one's own fails; what was sent by then is recorded.
        """
        start_ns = SYSTEM_CLOCK.now_ns()
        with self._files:
            while self._loop.done < self._scenario.ticks and not stop.wanted:
                begin = self._loop.done
                try:
                    self._loop.run(begin + BLOCK_TICKS)
                finally:
                    self._record(begin, self._loop.done)
                on_tick(self._loop.done)
        return (SYSTEM_CLOCK.now_ns() - start_ns) / NS_PER_S

    @property
    def ticks(self) -> int:
        """How many are done."""
        return self._loop.done

    @property
    def columns(self) -> RunColumns:
        """What the run carried."""
        plant = None if self._linear is None else self._reported(0, self.ticks)
        return RunColumns(self.ticks, self._loop.trace, self._delivery, plant)

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        network = self._network
        own = network.on_the_bus[: network.offered]
        always: dict[str, dict[str, int]] = {codec.name: {} for codec in (network.status, *own)}
        return delivery(self._scenario, network, self.ticks).rejected | always

    def _record(self, begin: int, end: int) -> None:
        """Frames and reports of the ticks from ``begin`` to ``end``."""
        network, trace, some = self._network, self._loop.trace, slice(begin, end)
        own = network.offered
        frames = [
            payloads(codec, values[some], begin)
            for codec, values in (
                (network.reference, trace.reference),
                (network.feedback, trace.measured),
                (network.command_1, trace.command_1),
                (network.command_2, trace.command_2),
            )
        ]
        frames.append(
            payloads(
                network.status,
                trace.fault_estimate[some],
                begin,
                trace.mode[some],
                trace.fault_state[some],
                trace.verdict[some],
            )
        )
        if network.speed is not None and self._speed is not None:
            frames.insert(0, payloads(network.speed, self._speed[some], begin))
        data = np.stack(frames, axis=1)
        damage = self._delivery.damage
        ticks, channels, at, change = damage[(damage[:, 0] >= begin) & (damage[:, 0] < end)].T
        data[ticks - begin, own + channels, at] ^= change.astype(np.uint8)
        there = np.ones((end - begin, len(frames)), dtype=np.bool_)
        there[:, own : own + 2] = self._delivery.sent[some]
        first_us = np.arange(begin, end, dtype=np.int64) * self._scenario.tick_ns // 1000
        lines = candump_bytes(data, there, first_us, network.identifiers, own)
        self._log.write_bytes(lines)
        if self._linear is not None:
            self._reports.record_columns(begin, self._reported(begin, end))

    def _reported(self, begin: int, end: int) -> dict[str, FloatArray]:
        assert self._linear is not None
        loop = self._loop
        return self._linear.report_columns(
            loop.trace.measurement,
            loop.plant_states,
            loop.reached,
            loop.inputs[3],
            range(begin, end),
        )


class _Reporting:
    """A plant of one's own whose reports are recorded as it goes on."""

    def __init__(self, plant: PlantBehind, reports: PlantRecorder) -> None:
        self._plant = plant
        self._reports = reports
        self._tick = 0

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``PlantBehind``."""
        reported = self._plant.report(command_1, command_2, left_1, left_2)
        answer = self._plant.follow(command_1, command_2, left_1, left_2)
        self._reports.record(self._tick, reported)
        self._tick += 1
        return answer
