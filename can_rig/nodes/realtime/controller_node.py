"""The controller node in real time: it answers what can still be in time, and can join late.

A sample whose answer would come too late (a newer one, ``latency_ticks`` on, is already here) is
not answered. Whether commands that were sent came too late shows in the time stamp of the frame
that the plant node sent next, right after it had looked for them. Either way the node knows what
the actuators did without them, hold and then drop to zero, and tells F1, so that F1 goes on with
what the car got and d̂ shows no fault that is none.

A controller that comes late, because it was started again or stood still for longer than the
actuators hold a command and ``takeover`` listens, takes over as ``takeover`` says. The first tick
that it hears says whether it is late: a run begins with tick 0. The wire carries 16 bits of the
tick; started again after more than 65536 ticks the node takes them modulo that, so its
``frames-…`` faults come at the wrong time, and the run ends when the plant node falls silent.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import can

from can_rig.errors import BusError
from can_rig.frames.network import Network
from can_rig.nodes.controller_node import ControllerNode
from can_rig.nodes.lockstep import Watchdog
from can_rig.nodes.realtime.deadlines import require_causal
from can_rig.nodes.realtime.takeover import LISTEN_S, TakeOver
from can_rig.plant.simulated import Actuator
from can_rig.scenario.build import controller_table
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware
from firmware_model.target.status import FaultState, Mode

MOST_OTHERS = 30  # frames looked at behind a sample before it is answered: a flood never ends
BEHIND = 1 << 15  # of 16 bits of a tick: half of them are the past
SAME_CLOCK_S = 1.0  # time stamps further from ours are of another clock


class Sample(NamedTuple):
    """What one tick brings."""

    tick: int
    reference: float
    measurement: float
    offered_s: float
    """When the plant node sent it, by the bus's time stamp."""


class Sent(NamedTuple):
    """The commands of one tick and when they were sent, by the clock of the bus's time stamps."""

    commands: tuple[float, float]
    at_s: float


NOTHING = Sent((math.nan, math.nan), math.inf)


def warm_up(scenario: Scenario, network: Network) -> None:
    """Compile what a tick needs: on the bus already, the node would let frames pile up meanwhile.

    Raises:
        ScenarioError: a design that cannot be made.
    """
    table = controller_table(scenario, network)
    firmware = Firmware(table)
    firmware.step(math.nan, math.nan)
    firmware.reset(0.0)
    TakeOver(scenario, table, network.feedback.lsb)


class RealTimeControllerNode(ControllerNode):
    """Answers each feedback frame that is not too old, and takes over where it comes late.

    Args:
        scenario: the run.
        network: its frames.
        bus: where to send, and to look for what waits behind the frame that was received.
        now_s: the clock of the bus's time stamps; where it is not, they say nothing.

    Raises:
        ScenarioError: a latency of zero, a design that cannot be made.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        bus: can.BusABC,
        now_s: Callable[[], float] = time.time,
    ) -> None:
        require_causal(scenario)
        super().__init__(scenario, network, bus)
        self._latency_ticks = scenario.latency_ticks
        hold_ticks = round(scenario.actuator.hold_s / scenario.tick_s)
        self._actuators = (Actuator(hold_ticks), Actuator(hold_ticks))  # as the car's should be
        # By tick, modulo; None: what F1 has there is right.
        self._sent: list[Sent | None] = [None] * self._latency_ticks
        self._most_missed = hold_ticks + round(LISTEN_S / scenario.tick_s)
        self._missed = self._too_late = 0  # in a row: samples, commands
        self._now_s = now_s
        self._offered_s = 0.0  # the last reference's time stamp
        self._command_ids = {network.command_1.frame_id, network.command_2.frame_id}
        self._new_take_over = partial(TakeOver, scenario, self._table, network.feedback.lsb)
        self._take_over: TakeOver | None = self._new_take_over()
        self._waiting: list[Sample] = []

    def serve(self, watchdog: Watchdog) -> None:
        """Wait for frames and answer the samples among them.

        Raises:
            SilentNodeError, Interrupted: see ``Watchdog.receive``.
            BusError: another controller node is at work.
        """
        message: can.Message | None = watchdog.receive(self._tick)
        others = samples = 0
        while message is not None:
            self._take_in(message)
            others = others + 1 if len(self._waiting) == samples else 0
            samples = len(self._waiting)
            message = self._bus.recv(0) if others < MOST_OTHERS else None
        if not self._waiting:
            watchdog.go_on_waiting(self._tick)
            return
        watchdog.hear()
        newest = self._waiting[-1].tick
        for sample in self._waiting:
            self._miss(range(self._tick, sample.tick))
            if newest - sample.tick < self._latency_ticks:
                self._answer_sample(sample)
            elif self._listens:
                self._listen(sample.measurement)
            else:
                self._miss(range(sample.tick, sample.tick + 1), sample.offered_s)
            self._tick = sample.tick + 1
        self._waiting.clear()

    def _take_in(self, message: can.Message) -> None:
        number = message.arbitration_id
        if number == self._reference.codec.frame_id:
            self._reference_now = self._reference.accept(message) or self._reference_now
            self._offered_s = message.timestamp
        elif number == self._feedback.codec.frame_id:
            self._take_in_feedback(message)
        elif number in self._command_ids and self._listens:
            raise BusError(
                "another controller node sends commands on this bus; one at a time is right"
            )

    def _take_in_feedback(self, message: can.Message) -> None:
        due = self._expected or 0
        ahead = (int.from_bytes(message.data[2:4], "little") - due) & 0xFFFF
        if self._expected is not None and ahead >= BEHIND:
            self._feedback.accept(message, due)  # an old one, which it counts
            return
        record = self._feedback.accept(message)
        if record is None:
            return
        tick = due + ahead
        if self._expected is None:
            self._tick = tick
            if tick == 0:
                self._take_over = None  # the run begins with us
        self._expected = tick + 1
        now = self._reference_now
        reference = now.value if now.tick == record.tick else math.nan
        self._waiting.append(Sample(tick, reference, record.value, self._offered_s))

    def _miss(self, ticks: range, offered_s: float = -math.inf) -> None:
        """Let ``ticks`` pass for which no command can be in time."""
        for tick in ticks[: max(0, self._most_missed - self._missed)]:
            if self._listens:
                self._listen(math.nan)
                continue
            self._look_back(tick, offered_s)
            if self._take_over is not None:
                self._take_over.miss()
            self._firmware.step(math.nan, math.nan)
        self._missed += len(ticks)
        if self._missed > self._most_missed:
            self._begin_take_over()

    def _look_back(self, tick: int, offered_s: float) -> None:
        """What acts from ``tick`` on: the commands that were sent in time, or what actuators do."""
        at = tick % self._latency_ticks
        sent, self._sent[at] = self._sent[at], NOTHING
        if sent is None:
            return
        if sent is not NOTHING and not offered_s < sent.at_s < offered_s + SAME_CLOCK_S:
            for actuator, command in zip(self._actuators, sent.commands, strict=True):
                actuator.hear(command)
            self._too_late = 0
            return
        self._firmware.act(*(actuator.hear(None) for actuator in self._actuators))
        self._too_late += 1
        if self._too_late > self._most_missed:
            self._begin_take_over()

    def _answer_sample(self, sample: Sample) -> None:
        tick, reference = sample.tick, sample.reference
        self._missed = 0
        if self._listens:
            self.send(self._send_status.frame(0.0, tick, Mode.INIT, FaultState.CANNOT_TELL))
            self._listen(sample.measurement)
            return
        self._look_back(tick, sample.offered_s)
        if self._take_over is not None:
            reference = self._take_over.reference(reference)
            if self._take_over.done:
                self._take_over = None
        self._send_answer(tick, reference, sample.measurement)

    def _send_commands(self, tick: int, command_1: float, command_2: float) -> None:
        super()._send_commands(tick, command_1, command_2)
        self._sent[tick % self._latency_ticks] = Sent((command_1, command_2), self._now_s())

    @property
    def _listens(self) -> bool:
        return self._take_over is not None and self._take_over.listens

    def _begin_take_over(self) -> None:
        self._take_over = self._new_take_over()
        self._too_late = 0

    def _listen(self, measurement: float) -> None:
        assert self._take_over is not None
        self._take_over.hear(measurement)
        if self._take_over.listens:
            return
        if not self._take_over.heard_enough:
            self._begin_take_over()
        else:
            self._take_over.start(self._firmware)
            self._sent = [None] * self._latency_ticks
            for actuator, command in zip(self._actuators, self._firmware.commands, strict=True):
                actuator.hear(command)
