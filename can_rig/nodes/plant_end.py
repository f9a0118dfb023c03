"""The plant's end of a tick's frames: sends its own and judges the three answer frames."""

from __future__ import annotations

import math
from typing import Final

import can
import numpy as np

from can_rig.frames.codec import Record
from can_rig.frames.endpoints import Receiver, Transmitter
from can_rig.frames.network import Network
from can_rig.frames.wire_tick import ticks_ahead
from can_rig.nodes.bus_access import Send
from can_rig.nodes.recording.plant_recorder import PlantRecorder
from can_rig.nodes.recording.recorder import Log
from can_rig.plant.faults.frame_faults import SENSOR_PLACE, FrameFaults
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.driving.speed import speeds_at_ticks
from can_rig.scenario.reference import reference, refuse_saturation
from can_rig.scenario.settings import Scenario

COMMANDS: Final = 2
"""What is received is numbered: the commands first, then the status."""


class PlantEnd:
    """Samples the plant, sends D* with the reference, and judges commands and status.

    Args:
        scenario: the run; its frame faults act on D*; ``latency_ticks`` is the delay of the
            simulated plant's commands.
        network: the frames of the run.
        send: sends a frame.
        log: gets every sent frame; None records nothing.
        reports: gets the plant's report of every tick; None records nothing.
        changing: whether the faults may change during the run.

    Raises:
        ScenarioError: a reference beyond the range of its frame, an invalid plant.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        send: Send,
        log: Log | None,
        reports: PlantRecorder | None = None,
        changing: bool = False,
    ) -> None:
        self.plant: Final = SimulatedPlant(scenario, changing)
        self.reference_offset = 0.0
        """Added to the scenario's reference, m/s²."""
        refuse_saturation(scenario, network)
        self._reference = reference(scenario)
        self._send = send
        self._log = log
        self._reports = reports
        self._send_reference = Transmitter(network.reference)
        self._send_feedback = Transmitter(network.feedback)
        self._send_nothing = Transmitter(network.feedback)  # with the counter of the other
        self._send_speed = None if network.speed is None else Transmitter(network.speed)
        self._speeds = np.empty(0) if network.speed is None else speeds_at_ticks(scenario)
        self._faults = FrameFaults(scenario, network, changing)
        self._receivers = tuple(
            Receiver(codec) for codec in (network.command_1, network.command_2, network.status)
        )
        self._by_id = {each.codec.frame_id: at for at, each in enumerate(self._receivers)}
        self._offered: tuple[can.Message, ...] = ()

    def change_faults(self, scenario: Scenario) -> None:
        """From the next tick on, the faults of ``scenario``."""
        self.plant.change_faults(scenario)
        self._faults.change(scenario)

    def sample(self, tick: int) -> None:
        """Measure D* of ``tick`` and pack its frames."""
        wanted = self._reference.item(tick) + self.reference_offset
        reference = self._send_reference.frame(wanted, tick)
        own = self._send_feedback.frame(self.plant.measure(), tick)
        feedback = [own]
        if self._faults.concerns(SENSOR_PLACE):
            feedback = self._faults.on_the_wire(
                own, SENSOR_PLACE, tick, self._send_nothing.frame(math.nan, tick)
            )
        self._offered = (reference, *feedback)
        if self._send_speed is not None:
            self._offered = (self._send_speed.frame(self._speeds.item(tick), tick), *self._offered)

    def send_sample(self) -> None:
        """Send what was sampled."""
        for message in self._offered:
            self._send(message)
            if self._log is not None:
                self._log.record(message, sent=True)

    def repeat(self) -> None:
        """Send the offer again, for a controller that starts late; the log has one copy."""
        for message in self._offered:
            self._send(message)

    def judge(self, message: can.Message, tick: int) -> tuple[int, Record] | None:
        """Number and content of a valid frame of ``tick``; returns None for every other frame."""
        at = self._by_id.get(message.arbitration_id)
        if at is None:
            return None
        record = self._receivers[at].accept(message, tick)
        return None if record is None else (at, record)

    def age(self, message: can.Message, tick: int) -> int:
        """How many ticks before ``tick`` a frame's own tick lies; 0 for one that says none."""
        at = self._by_id.get(message.arbitration_id)
        says = None if at is None else self._receivers[at].codec.layout.tick(message.data)
        return 0 if says is None else -ticks_ahead(says, tick)

    def advance(self, tick: int, command_1: float | None, command_2: float | None) -> None:
        """Advance the plant by one tick with the valid commands of ``tick`` (None: missing)."""
        reported = self.plant.advance(tick, command_1, command_2)
        if self._reports is not None:
            self._reports.record(tick, reported)

    def end_tick(self) -> None:
        """No more of this tick comes."""
        for receiver in self._receivers:
            receiver.end_tick()

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        return {receiver.codec.name: receiver.rejected for receiver in self._receivers}
