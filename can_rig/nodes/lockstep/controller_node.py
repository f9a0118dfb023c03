"""The controller node in lockstep: an I/O shell around ``controller.step``."""

from __future__ import annotations

import math
from typing import Protocol

import can

from can_rig.frames.codec import Record
from can_rig.frames.endpoints import Receiver
from can_rig.frames.network import Network
from can_rig.frames.wire_tick import WIRE_TICKS, tick_from
from can_rig.nodes.bus_access import Send
from can_rig.nodes.controller_end import ControllerEnd, started
from can_rig.nodes.lockstep.answering import AnsweringNode
from can_rig.nodes.operator.following import FollowedFaults
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import PYTHON_LAW, Firmware, Law


class Actuation(Protocol):
    """The recorded timing of commands, for replay."""

    def begin(self, tick: int, firmware: Firmware) -> bool:
        """Tell the firmware the active commands from ``tick`` on; True for an answered sample."""

    def send(self, tick: int, commands: tuple[float, float]) -> None:
        """Note the commands of a tick."""


class ControllerNode(AnsweringNode):
    """Answers each feedback frame with two commands and a status.

    Args:
        scenario: the run.
        network: the frames of the run.
        send: sends a frame.
        actuation: command timing of a recorded real-time run; None: every answer is in time.
        law: the implementation of the control law.

    Raises:
        ScenarioError: the design fails.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        send: Send,
        actuation: Actuation | None = None,
        law: Law = PYTHON_LAW,
    ) -> None:
        self._actuation = actuation
        self.ticks = scenario.ticks
        self._end = ControllerEnd(scenario, network, send)
        self._followed = FollowedFaults(scenario, self._end.faults)
        _, self._firmware = started(scenario, network, law)
        self._reference_now = Record(math.nan, -1)
        self._tick = 0  # the next one
        self._expected: int | None = None  # the first contact sets the tick
        self._first_reference: can.Message | None = None
        self._first_speed: can.Message | None = None

    @property
    def tick(self) -> int:
        """The tick that is answered next."""
        return self._tick

    def take(self, message: can.Message) -> bool:
        """Receive a frame; returns True if the frame completed a tick, which is then answered."""
        if self._followed.take(message, self._tick):
            return False
        if self._expected is None and not self._first_contact(message):
            return False
        if self._end.is_speed(message):
            self._take_speed(message)
        elif message.arbitration_id == self._end.reference.codec.frame_id:
            record = self._end.reference.accept(message, self._expected)
            self._reference_now = record or self._reference_now
        elif message.arbitration_id == self._end.feedback.codec.frame_id:
            record = self._end.feedback.accept(message, self._expected)
            if record is not None:
                self._answer(record.tick, record.value)
                return True
        return False

    def _first_contact(self, message: can.Message) -> bool:
        """Whether ``message`` is the first feedback: intact, and of the tick of the reference.

        A forged frame has the right CRC with probability 1/256, and no expected tick exists yet to
        reject the frame. First contact therefore needs two consistent frames; before first contact
        no protection checker sees any frame.
        """
        reference, feedback = self._end.reference, self._end.feedback
        if message.arbitration_id == reference.codec.frame_id:
            self._first_reference = message
        elif self._end.is_speed(message):
            self._first_speed = message
        elif message.arbitration_id == feedback.codec.frame_id and self._first_reference:
            pair = ((reference, self._first_reference), (feedback, message))
            one, other = (Receiver(receiver.codec).accept(frame) for receiver, frame in pair)
            if one is not None and other is not None and one.tick == other.tick:
                reference.accept(self._first_reference, one.tick)
                self._reference_now, self._expected = one, one.tick
                if self._first_speed is not None:
                    self._take_speed(self._first_speed)
                return True
        return False

    def _take_speed(self, message: can.Message) -> None:
        """Pass the speed to the firmware; without a frame, the firmware keeps the last speed."""
        record = self._end.speed_of(message, self._expected)
        if record is not None:
            self._firmware.change_speed(record.value)

    @property
    def expected(self) -> int | None:
        """The tick of the next expected frames; None before the first contact."""
        return self._expected

    def miss(self) -> None:
        """Skip the expected tick without feedback: the firmware holds, and reports the miss.

        In lockstep, time stands still until the feedback arrives; callers that know about passed
        ticks report each with this method.
        """
        assert self._expected is not None
        self._answer(self._expected % WIRE_TICKS, math.nan)

    def _answer(self, wire_tick: int, measurement: float) -> None:
        tick = tick_from(wire_tick, self._tick)
        now = self._reference_now
        reference = now.value if now.tick == wire_tick else math.nan  # none: hold, and say so
        if self._actuation is not None and not self._actuation.begin(tick, self._firmware):
            reference = measurement = math.nan
        answer = self._firmware.step(reference, measurement)
        if self._actuation is not None:
            self._actuation.send(tick, (answer.command_1, answer.command_2))
        self._end.send_commands(tick, answer.command_1, answer.command_2)
        self._end.send_status(
            tick, answer.fault_estimate, answer.mode, answer.fault_state, answer.verdict
        )
        self._end.end_tick()
        self._tick = self._expected = tick + 1

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        return self._end.rejected()
