"""Both nodes without a bus: many ticks compiled, then all their frames at once.

What is recorded is what the two nodes record in lockstep, byte for byte.
"""

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from can_rig.controllers.protocol import ages_of
from can_rig.frames.codec import FRAME_BYTES
from can_rig.frames.frame_columns import UInt8s, payloads
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import OnTick, StopRequest
from can_rig.nodes.recording import LogFile, PlantRecorder, candump_bytes
from can_rig.nodes.ticks import NodeSummary, RunColumns, timed
from can_rig.plant.actuated_plant import ActuatedLinearPlant, ActuatedPlant
from can_rig.plant.changing_car import plant_of
from can_rig.plant.faults.frame_faults import delivery
from can_rig.plant.frameless import carried
from can_rig.plant.in_windows import LoopInWindows
from can_rig.plant.witnesses import Sensed, hearing_of
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import Outage
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.law.structs import BoolArray, FloatArray


def run_without_bus(
    scenario: Scenario, log: Path, stop: StopRequest, on_tick: OnTick
) -> NodeSummary:
    """Both nodes and no bus; the log is that of two processes, byte for byte.

    Raises:
        RigError: an exception in the user's plant class; the log has every sent frame.
    """
    with RunWithoutBus(scenario, log) as run:

        def carry(_tick: int) -> int:
            stop.require_none()
            return run.carry()

        summary = timed(carry, scenario.ticks, on_tick)
    summary.rejected_frames, summary.columns = run.rejected(), run.columns
    summary.ticks_per_s = summary.ticks / summary.wall_s if summary.wall_s else 0.0
    return summary


class RunWithoutBus:
    """A scenario, recorded as it goes on.

    Raises:
        ScenarioError: a scenario that cannot run.
        RunFolderError: the log cannot be written.
    """

    def __init__(self, scenario: Scenario, log: Path) -> None:
        self._scenario = scenario
        self._network: Network = network_of(scenario)
        self._files = ExitStack()
        self._log = LogFile(log)
        self._files.callback(self._log.close)
        self._reports = self._files.enter_context(PlantRecorder(log))
        plant, sensors = plant_of(scenario), self._network.witnesses
        self._linear = plant if isinstance(plant, ActuatedLinearPlant) and not sensors else None
        reporting = _Reporting(plant, self._reports)
        self._sensed = Sensed(scenario, self._network, reporting) if sensors else None
        self._frames: dict[str, FloatArray] = {}
        self._plant: dict[str, FloatArray] = {}
        self._said: dict[str, FloatArray] = {}
        self._sample_ages: dict[str, FloatArray] = {}
        self._hearing = hearing_of(scenario, self._network)
        self._names = [each.usual.column for each in scenario.sensors]
        self._ages = ages_of(self._names)
        self._run = LoopInWindows(
            scenario,
            self._network,
            self._sensed or (self._linear.sampled if self._linear else reporting),
            keeps_states=True,
        )
        self._run.loop.run(0)  # compiles, or loads what was compiled, before the first tick

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._files.close()

    def carry(self) -> int:
        """Carry a block of ticks; returns the number of ticks completed; see ``drive``."""
        begin = self.ticks
        try:
            self._run.run()
        finally:
            self._record(range(begin, self.ticks))
        return self.ticks

    @property
    def ticks(self) -> int:
        """How many are done."""
        return self._run.done

    @property
    def columns(self) -> RunColumns:
        """What the run carried."""
        done = slice(self.ticks)
        frames, plant, *sensors = (
            {name: column[done] for name, column in columns.items()}
            for columns in (self._frames, self._plant, self._said, self._sample_ages)
        )
        return RunColumns(frames, None if self._linear is None else plant, *sensors)

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        network = self._network
        own = (*network.inputs, *network.witnesses)
        always: dict[str, dict[str, int]] = {codec.name: {} for codec in own}
        return delivery(self._scenario, network, self.ticks).rejected | always

    def _record(self, ticks: range) -> None:
        """Frames and reports of some ticks."""
        network, trace, some = self._network, self._run.loop.trace, self._run.here(ticks)
        inputs, begin = self._run.inputs, ticks.start
        own = network.offered + len(network.witnesses)
        powered, counts = _powered(self._scenario.outages, ticks)
        frames = [
            payloads(codec, values[some], begin, counts=sent_before)
            for codec, values, sent_before in (
                (network.reference, trace.reference, None),
                (network.feedback, trace.measured, None),
                (network.command_1, trace.command_1, counts),
                (network.command_2, trace.command_2, counts),
            )
        ]
        estimate, mode = trace.fault_estimate[some], trace.mode[some]
        state, verdict = trace.fault_state[some], trace.verdict[some]
        frames.append(payloads(network.status, estimate, begin, mode, state, verdict, counts))
        witnesses, witnessed = self._witnessed(ticks)
        frames[:0] = witnesses
        if network.speed is not None and inputs.speed is not None:
            frames.insert(0, payloads(network.speed, inputs.speed[some], begin))
        data = np.stack(frames, axis=1)
        damage = inputs.delivery.damage
        rows, channels, at, change = damage[
            (damage[:, 0] >= some.start) & (damage[:, 0] < some.stop)
        ].T
        data[rows - some.start, own + channels, at] ^= change.astype(np.uint8)
        there = np.ones((len(ticks), len(frames)), dtype=np.bool_)
        there[:, own : own + 2] = inputs.delivery.sent[some]
        there[:, own + 2] = powered
        there[:, network.offered - 2 : own - 2] = witnessed
        first_us = np.array(ticks, dtype=np.int64) * self._scenario.tick_ns // 1000
        lines = candump_bytes(data, there, first_us, network.identifiers, own)
        self._log.write(lines)
        self._keep(self._frames, ticks, carried(trace, inputs.delivery, some, network))
        if self._linear is not None:
            loop = self._run.loop
            reported = self._linear.report_columns(
                trace.measurement, loop.plant_states, loop.reached, loop.inputs[3],
                range(some.start, some.stop),
            )  # fmt: skip
            self._reports.record_columns(begin, reported)
            self._keep(self._plant, ticks, reported)

    def _witnessed(self, ticks: range) -> tuple[list[UInt8s], BoolArray]:
        """The frames of the further sensors, and in which ticks they are sent."""
        if self._sensed is None:
            return [], np.zeros((len(ticks), 0), dtype=np.bool_)
        codecs = self._network.witnesses
        places = {codec.frame_id: at for at, codec in enumerate(codecs)}
        shape = len(ticks), len(codecs)
        sent = np.zeros(shape, dtype=np.bool_)
        frames = np.zeros((*shape, FRAME_BYTES), dtype=np.uint8)
        heard = []
        for row, messages in enumerate(list(self._sensed.sent)[-len(ticks) :]):
            for message in messages:
                at = places[message.arbitration_id]
                frames[row, at], sent[row, at] = list(message.data), True
                self._hearing.take(message, ticks[row])
            heard.append(self._hearing.end_tick(ticks[row]))
        for names, columns in ((self._names, self._said), (self._ages, self._sample_ages)):
            said = {name: np.array([each[name] for each in heard]) for name in names}
            self._keep(columns, ticks, said)
        return list(frames.swapaxes(0, 1)), sent

    def _keep(
        self, columns: dict[str, FloatArray], ticks: range, said: dict[str, FloatArray]
    ) -> None:
        """Add some ticks to columns that have a place for every tick of the run."""
        for name, values in said.items():
            if name not in columns:
                columns[name] = paged.empty(self._scenario.ticks)
            columns[name][ticks.start : ticks.stop] = values


def _powered(outages: Iterable[Outage], ticks: range) -> tuple[BoolArray, NDArray[np.int64]]:
    """(ticks,), whether the controller has power; (ticks,), its ticks since it began."""
    powered, counts = np.ones(len(ticks), dtype=np.bool_), np.array(ticks, dtype=np.int64)
    for outage in outages:
        first, end = (
            min(max(at - ticks.start, 0), len(ticks)) for at in (outage.start, outage.stop)
        )
        powered[first:end] = False
        counts[end:] = np.arange(end + ticks.start, ticks.stop) - outage.stop
    return powered, counts


class _Reporting:
    """A plant of one's own whose reports are recorded as it goes on."""

    def __init__(self, plant: ActuatedPlant, reports: PlantRecorder) -> None:
        self._plant = plant
        self._reports = reports
        self._tick = 0
        self.witnesses = plant.witnesses
        """See ``ActuatedPlant``."""

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``ActuatedPlant``."""
        reported = self._plant.report(command_1, command_2, left_1, left_2)
        answer = self._plant.follow(command_1, command_2, left_1, left_2)
        self._reports.record(self._tick, reported)
        self._tick += 1
        return answer
