"""The controller node in real time: answers every sample that can be in time, and can join late.

A sample whose answer would come too late (a newer sample, ``latency_ticks`` on, is already here)
stays unanswered. The plant node looks for commands and sends its next frame right afterwards, so
the time stamp of this frame shows which sent commands came too late. After an unanswered sample and
after a late command the node computes the actuators' reaction, hold and then drop to zero, and
passes the commands to F1. F1 then works on the car's actual inputs, and d̂ shows no false fault.

A controller comes late after a restart, or after standing still for longer than the actuators hold
a command and ``LISTEN_S``. The node then listens for ``LISTEN_S``, lest two controllers drive one
car, and the controller takes over (``NodeController.take_over``). The first received tick shows a
late start: a run begins with tick 0. The wire carries 16 bits of the tick; after a
restart past tick 65536 the node counts ticks modulo 65536, so its ``frames-…`` faults come at the
wrong time, and the run ends when the plant node falls silent.
"""

import math
from typing import Final, NamedTuple

import can

from can_rig.controllers.protocol import LISTEN_S, Answer, InNode, Inputs, said
from can_rig.errors import BusError, ScenarioError, SilentNodeError
from can_rig.frames.codec import NO_RECORD, Record, is_frame_of, tick_from, ticks_ahead
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import NS_PER_S, SYSTEM_CLOCK, Clock, Interrupted, NodeBus, Watchdog
from can_rig.nodes.ends import ControllerEnd
from can_rig.nodes.realtime.timing import require_causal
from can_rig.plant.actuators import Actuator
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import FaultState, Mode, Verdict

MOST_OTHERS: Final = 30
"""Frames looked at after a sample before it is answered: a flood never ends."""

TRIALS: Final = 5
"""Steps at rest that tell how long a step takes at least."""

FEWEST_SAMPLES: Final = 10
"""Least ticks of listening, however long a tick is."""

SAME_CLOCK_S: Final = 1.0
"""Time stamps further from ours are of another clock."""


class Sample(NamedTuple):
    """What one tick brings."""

    tick: int
    inputs: Inputs
    offered_s: float
    """When the plant node sent it, by the bus's time stamp."""


class Sent(NamedTuple):
    """The commands of one tick and their send time, on the clock of the bus's time stamps."""

    commands: tuple[float, float]
    at_s: float


NOTHING = Sent((math.nan, math.nan), math.inf)
LISTENING: Final = said(
    Answer(0.0, 0.0, 0.0, Mode.STANDBY, FaultState.CANNOT_TELL, Verdict.NOTHING)
)
"""The status of a controller that does not send commands yet."""


def warm_up(
    scenario: Scenario, network: Network, controller: InNode, clock: Clock = SYSTEM_CLOCK
) -> None:
    """Compile what a tick needs: on the bus already, the node would let frames pile up meanwhile.

    Raises:
        ScenarioError: a design that cannot be made, or a controller too slow for its tick.
    """
    started = controller.start(scenario, network)
    started.act(0.0, 0.0)
    least_s = math.inf
    for _ in range(TRIALS):
        begin_s = clock.now_ns() / NS_PER_S
        started.step(Inputs(0.0, 0.0))
        least_s = min(least_s, clock.now_ns() / NS_PER_S - begin_s)
    if least_s > scenario.tick_s:
        raise ScenarioError(
            f"scenario {scenario.name}: controller.kind = {scenario.controller.kind!r}: too slow "
            f"in real time: a step takes {least_s * 1e3:.3g} ms at least and must take less than "
            f"tick_s = {scenario.tick_s:g}; a run in lockstep waits"
        )


class RealTimeControllerNode:
    """Answers each feedback frame that is not too old, and takes over after a late start.

    Args:
        scenario: the run.
        network: the frames of the run.
        bus: for sending, and for a look at frames queued after the received frame; never raises
            ``can.CanError``.
        clock: the time; a clock other than the clock of the bus's time stamps makes the stamps
            meaningless.
        controller: starts the controller.

    Raises:
        ScenarioError: a latency of zero, or the design fails.
    """

    def __init__(
        self, scenario: Scenario, network: Network, bus: NodeBus, clock: Clock, controller: InNode
    ) -> None:
        require_causal(scenario)
        self.ticks: Final = scenario.ticks
        self._end = ControllerEnd(scenario, network, bus.send)
        self._controller = controller.start(scenario, network)
        self._bus = bus
        self._clock = clock
        self._latency_ticks = scenario.latency_ticks
        hold_ticks = round(scenario.actuator.hold_s / scenario.tick_s)
        self._actuators = (Actuator(hold_ticks), Actuator(hold_ticks))  # as the car's should be
        # By tick, modulo; None: F1 has it already.
        self._sent: list[Sent | None] = [None] * self._latency_ticks
        self._listen_ticks = max(round(LISTEN_S / scenario.tick_s), FEWEST_SAMPLES)
        held_ticks = hold_ticks + scenario.latency_ticks
        self._let_go = held_ticks < self._listen_ticks  # the actuators, after listening
        self._most_missed = hold_ticks + round(LISTEN_S / scenario.tick_s)
        self._missed = self._too_late = 0  # in a row: samples, commands
        self._tick = 0  # the next one
        self._expected: int | None = None  # the first contact sets the tick
        self._reference_now = NO_RECORD
        self._speed_now = NO_RECORD
        self._offered_s = 0.0  # the last reference's time stamp
        self._commands = (network.command_1, network.command_2)
        self._listened: list[Inputs] | None = []  # the inputs heard; None: the controller drives
        self._waiting: list[Sample] = []

    def carry(self, watchdog: Watchdog, tick: int) -> int:
        """Answer samples until ``tick`` is over; see ``drive``.

        Frames without a tick hide the number of missed frames and therefore the last tick: such a
        run ends with the silence of the plant node.

        Raises:
            SilentNodeError: the plant node is silent.
            BusError: another controller node is at work.
            Interrupted: a stop was requested.
        """
        while self._tick <= tick:
            watchdog.stop.require_none()
            try:
                self.serve(watchdog)
            except SilentNodeError:
                if self._end.feedback.codec.layout.has_tick or self._tick == 0:
                    raise
                raise Interrupted from None
        return self._tick

    def serve(self, watchdog: Watchdog) -> None:
        """Wait for frames and answer the samples among them; errors as of ``carry``."""
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
            elif self._listened is not None:
                self._listen(sample.inputs)
            else:
                late = range(sample.tick, sample.tick + 1)
                self._miss(late, sample.offered_s, sample.inputs.speed_mps)
            self._tick = sample.tick + 1
        self._waiting.clear()

    def _take_in(self, message: can.Message) -> None:
        if message.is_remote_frame or message.is_error_frame:
            return
        reference, receiver = self._end.reference, self._end.receiver_of(message)
        if receiver is reference:
            tick = None if reference.codec.layout.has_tick else self._expected
            self._reference_now = reference.accept(message, tick) or self._reference_now
            self._offered_s = message.timestamp
        elif receiver is self._end.feedback:
            self._take_in_feedback(message)
        elif receiver is not None:
            self._speed_now = receiver.accept(message) or self._speed_now
        elif self._end.witnesses.concerns(message):
            self._end.witnesses.take(message, None)
        elif self._listened is not None and is_frame_of(self._commands, message):
            raise BusError(
                "another controller node sends commands on this bus; there must be only one"
            )

    def _take_in_feedback(self, message: can.Message) -> None:
        feedback, due = self._end.feedback, self._expected
        says = feedback.codec.layout.tick(message.data)
        if due is not None and says is not None and ticks_ahead(says, due) < 0:
            feedback.accept(message, due)  # an old one, which it counts
            return
        record = feedback.accept(message, None if says is not None else due)
        if record is None:
            return
        tick = tick_from(record.tick, due or 0)
        if self._expected is None:
            self._tick = tick
            if tick == 0:
                self._listened = None  # the run begins with us
        self._expected = tick + 1
        reference, self._reference_now = self._of_tick(self._reference_now, record.tick)
        speed, self._speed_now = self._of_tick(self._speed_now, record.tick)
        inputs = Inputs(reference, record.value, speed, self._end.witnesses.end_tick(tick))
        self._waiting.append(Sample(tick, inputs, self._offered_s))

    @staticmethod
    def _of_tick(record: Record, tick: int) -> tuple[float, Record]:
        """The value of ``record`` in ``tick``, and what is left for later: its number comes again.

        The number of a tick has 16 bits.
        """
        value = record.value if record.tick == tick else math.nan
        return value, record if ticks_ahead(record.tick, tick) > 0 else NO_RECORD

    def _miss(
        self, ticks: range, offered_s: float = -math.inf, speed_mps: float = math.nan
    ) -> None:
        """Skip ``ticks`` ticks whose commands would all be too late."""
        nothing = Inputs(math.nan, math.nan, speed_mps)
        for tick in ticks[: max(0, self._most_missed - self._missed)]:
            if self._listened is not None:
                self._listen(nothing)
                continue
            self._look_back(tick, offered_s)
            self._controller.step(nothing)
        self._missed += len(ticks)
        if self._missed > self._most_missed:
            self._begin_restart()

    def _look_back(self, tick: int, offered_s: float) -> None:
        """Active commands from ``tick`` on: commands sent in time, or actuators' substitutes."""
        at = tick % self._latency_ticks
        sent, self._sent[at] = self._sent[at], NOTHING
        if sent is None:
            return
        if sent is not NOTHING and not offered_s < sent.at_s < offered_s + SAME_CLOCK_S:
            for actuator, command in zip(self._actuators, sent.commands, strict=True):
                actuator.hear(command)
            self._too_late = 0
            return
        self._controller.act(*(actuator.hear(None) for actuator in self._actuators))
        self._too_late += 1
        if self._too_late > self._most_missed:
            self._begin_restart()

    def _answer_sample(self, sample: Sample) -> None:
        tick, inputs = sample.tick, sample.inputs
        self._missed = 0
        if self._listened is not None:
            self._end.send_status(tick, LISTENING)
            self._listen(inputs)
            return
        self._look_back(tick, sample.offered_s)
        answer = self._controller.step(inputs)
        commands = answer.command_1, answer.command_2
        self._end.send_commands(tick, *commands)
        self._sent[tick % self._latency_ticks] = Sent(commands, self._clock.stamp_s())
        self._end.send_status(tick, said(answer))

    def _begin_restart(self) -> None:
        self._listened = []
        self._too_late = 0

    def _listen(self, inputs: Inputs) -> None:
        """Take in a tick without commands; after enough samples the controller takes over."""
        assert self._listened is not None
        self._listened.append(inputs)
        if len(self._listened) < self._listen_ticks:
            return
        heard = [each for each in self._listened if math.isfinite(each.measurement)]
        if 2 * len(heard) < self._listen_ticks:
            self._begin_restart()
            return
        self._listened = None
        self._controller.take_over(heard[-1], self._let_go)
        self._sent = [None] * self._latency_ticks
        for actuator, command in zip(self._actuators, self._controller.commands, strict=True):
            actuator.hear(command)

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        return self._end.rejected()
