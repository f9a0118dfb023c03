"""The controller node: an I/O shell around ``controller.step``."""

from __future__ import annotations

import math
from collections.abc import Callable

import can

from can_rig.build import controller_table
from can_rig.faults import FrameFault
from can_rig.lockstep import Interrupted, Patience
from can_rig.messages import Network, Receiver, Record, Transmitter
from can_rig.scenario import Scenario
from firmware_model.firmware import Firmware


class ControllerNode:
    """Answers each feedback frame with two commands and a status.

    Args:
        scenario: the run.
        network: its frames.
        bus: where to send.

    Raises:
        ScenarioError: a design that cannot be made.
    """

    def __init__(self, scenario: Scenario, network: Network, bus: can.BusABC) -> None:
        self.ticks = scenario.ticks
        self._firmware = Firmware(controller_table(scenario, network))
        self._firmware.step(math.nan, math.nan)  # compiles before the first tick needs it
        self._firmware.reset(0.0)
        self._frame_fault = FrameFault(scenario)
        self._bus = bus
        self._reference = Receiver(network.reference)
        self._feedback = Receiver(network.feedback)
        self._send_1 = Transmitter(network.command_1)
        self._send_2 = Transmitter(network.command_2)
        self._send_status = Transmitter(network.status)
        self._reference_now = Record(math.nan, -1)
        self._tick = 0  # the next one
        self._expected: int | None = None  # the first frame says which tick it is

    def run(self, patience: Patience, on_tick: Callable[[int], None]) -> int:
        """Answer ticks to the end of the run or to a stop request; the number answered.

        Raises:
            SilentNodeError: the plant node is silent.
        """
        while self._tick < self.ticks and not patience.stop.wanted:
            try:
                self.serve(patience)
            except Interrupted:
                break
            on_tick(self._tick)
        return self._tick

    def serve(self, patience: Patience) -> None:
        """Wait for one tick's feedback and answer it.

        Raises:
            SilentNodeError, Interrupted: see ``Patience.receive``.
        """
        while True:
            message = patience.receive(self._tick)
            if message.arbitration_id == self._reference.codec.frame_id:
                record = self._reference.accept(message, self._expected)
                if record is not None:
                    self._reference_now = record
                    continue
            elif message.arbitration_id == self._feedback.codec.frame_id:
                record = self._feedback.accept(message, self._expected)
                if record is not None:
                    break
            patience.go_on_waiting(self._tick)
        patience.hear()
        self._answer(record.tick, record.value)

    def _answer(self, wire_tick: int, measurement: float) -> None:
        # The wire carries 16 bits of the tick; the node counts on from there.
        tick = self._tick + ((wire_tick - self._tick) & 0xFFFF)
        now = self._reference_now
        reference = now.value if now.tick == wire_tick else math.nan  # none: hold, and say so
        command_1, command_2, estimate, mode, fault = self._firmware.step(reference, measurement)
        frames = (
            self._frame_fault.on_the_wire(self._send_1.frame(command_1, wire_tick), 0, tick),
            self._frame_fault.on_the_wire(self._send_2.frame(command_2, wire_tick), 1, tick),
            self._send_status.frame(estimate, wire_tick, mode, fault),
        )
        for frame in frames:
            if frame is not None:
                self._bus.send(frame)
        self._tick = self._expected = tick + 1

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        receivers = (self._reference, self._feedback)
        return {receiver.codec.name: receiver.rejected for receiver in receivers}
