"""The controller node: an I/O shell around ``controller.step``."""

from __future__ import annotations

import math
from collections.abc import Callable

import can

from can_rig.frames.codec import Record
from can_rig.frames.endpoints import Receiver, Transmitter
from can_rig.frames.network import Network
from can_rig.nodes.lockstep import Interrupted, Sender, Waiting, Watchdog
from can_rig.plant.faults import FrameFault
from can_rig.scenario.build import controller_table
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware


class ControllerNode:
    """Answers each feedback frame with two commands and a status.

    Args:
        scenario: the run.
        network: its frames.
        bus: where to send.
        waiting: how long the bus may refuse a frame.

    Raises:
        ScenarioError: a design that cannot be made.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        bus: can.BusABC,
        waiting: Waiting = Waiting(),  # noqa: B008 (frozen)
    ) -> None:
        self.ticks = scenario.ticks
        self._table = controller_table(scenario, network)
        self._firmware = Firmware(self._table)
        self._firmware.step(math.nan, math.nan)  # compiles before the first tick needs it
        self._firmware.reset(0.0)
        self._frame_fault = FrameFault(scenario)
        self._bus = bus
        self.send = Sender(bus, waiting.silence_s)
        self._reference = Receiver(network.reference)
        self._feedback = Receiver(network.feedback)
        self._send_1 = Transmitter(network.command_1)
        self._send_2 = Transmitter(network.command_2)
        self._send_status = Transmitter(network.status)
        self._reference_now = Record(math.nan, -1)
        self._tick = 0  # the next one
        self._expected: int | None = None  # the first contact says which tick it is
        self._first_reference: can.Message | None = None

    def run(self, watchdog: Watchdog, on_tick: Callable[[int], None]) -> int:
        """Answer ticks to the end of the run or to a stop request; the number answered.

        Raises:
            SilentNodeError: the plant node is silent.
            BusLostError: the bus carries nothing any more.
        """
        while self._tick < self.ticks and not watchdog.stop.wanted:
            try:
                self.serve(watchdog)
            except Interrupted:
                break
            on_tick(self._tick)
        return self._tick

    def serve(self, watchdog: Watchdog) -> None:
        """Wait for one tick's feedback and answer it.

        Raises:
            SilentNodeError, BusLostError, Interrupted: see ``Watchdog.receive``.
        """
        while True:
            message = watchdog.receive(self._tick)
            if self._expected is None and not self._first_contact(message):
                watchdog.go_on_waiting(self._tick)
                continue
            if message.arbitration_id == self._reference.codec.frame_id:
                record = self._reference.accept(message, self._expected)
                if record is not None:
                    self._reference_now = record
                    continue
            elif message.arbitration_id == self._feedback.codec.frame_id:
                record = self._feedback.accept(message, self._expected)
                if record is not None:
                    break
            watchdog.go_on_waiting(self._tick)
        watchdog.hear()
        self._answer(record.tick, record.value)

    def _first_contact(self, message: can.Message) -> bool:
        """Whether ``message`` is the first feedback: intact, and of the tick of the reference.

        One frame of 256 that another sender makes up has the right CRC, and would do where the tick
        is still anybody's guess. So two are wanted that agree; until then no checker sees any.
        """
        if message.arbitration_id == self._reference.codec.frame_id:
            self._first_reference = message
        elif message.arbitration_id == self._feedback.codec.frame_id and self._first_reference:
            pair = ((self._reference, self._first_reference), (self._feedback, message))
            one, other = (Receiver(receiver.codec).accept(frame) for receiver, frame in pair)
            if one is not None and other is not None and one.tick == other.tick:
                self._reference.accept(self._first_reference, one.tick)
                self._reference_now, self._expected = one, one.tick
                return True
        return False

    @property
    def expected(self) -> int | None:
        """The tick whose frames are wanted next; None before the first contact."""
        return self._expected

    def miss(self) -> None:
        """Let the expected tick pass without its feedback: the firmware holds, and says so.

        In lockstep time stands still until the feedback comes; who knows that it went on, says so
        by this.
        """
        assert self._expected is not None
        self._answer(self._expected & 0xFFFF, math.nan)

    def _answer(self, wire_tick: int, measurement: float) -> None:
        # The wire carries 16 bits of the tick; the node counts on from there.
        tick = self._tick + ((wire_tick - self._tick) & 0xFFFF)
        now = self._reference_now
        reference = now.value if now.tick == wire_tick else math.nan  # none: hold, and say so
        self._send_answer(tick, reference, measurement)
        self._reference.end_tick()
        self._feedback.end_tick()
        self._tick = self._expected = tick + 1

    def _send_answer(self, tick: int, reference: float, measurement: float) -> None:
        command_1, command_2, estimate, mode, fault = self._firmware.step(reference, measurement)
        self._send_commands(tick, command_1, command_2)
        self.send(self._send_status.frame(estimate, tick, mode, fault))

    def _send_commands(self, tick: int, command_1: float, command_2: float) -> None:
        frames = (
            self._frame_fault.on_the_wire(self._send_1.frame(command_1, tick), 0, tick),
            self._frame_fault.on_the_wire(self._send_2.frame(command_2, tick), 1, tick),
        )
        for frame in frames:
            if frame is not None:
                self.send(frame)

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        receivers = (self._reference, self._feedback)
        return {receiver.codec.name: receiver.rejected for receiver in receivers}
