"""Nodes in lockstep: virtual time stands still until the other node has answered.

A tick is five frames in a fixed order: reference and feedback from the plant node (with a drive,
the speed precedes both), then the commands and the status from the controller node. The feedback
starts the controller's tick, the status ends the plant's tick. A command missing at the arrival of
the status was therefore dropped, and no node waits for a dropped command.
"""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Final, Protocol

import can

from can_rig.buses.local.bus import LocalBus
from can_rig.controllers.protocol import (
    COUNTS,
    Ecu,
    InNode,
    Inputs,
    NodeController,
    Supplied,
    WholeNode,
    rejected,
)
from can_rig.errors import ExportError, ScenarioError
from can_rig.frames.codec import NO_RECORD, WIRE_TICKS, Receiver, tick_from, ticks_ahead
from can_rig.frames.network import Network, flagged, unflagged
from can_rig.nodes.bus_access import NS_PER_S, SYSTEM_CLOCK, Clock, NodeBus, Send, Watchdog
from can_rig.nodes.ends import COMMANDS, ControllerEnd, PlantEnd, Rejected, all_rejected
from can_rig.nodes.interaction import UNTOUCHED, Interaction
from can_rig.nodes.recording import PlantRecorder, Recorder
from can_rig.nodes.run_control import FollowedFaults, RunControl
from can_rig.plant.faults.frame_faults import FrameFaults
from can_rig.scenario.build import heard_by_law
from can_rig.scenario.settings import Scenario

CONTROL: Final = "RIG_CONTROL"

QUIET_S: Final = 0.02
"""When nothing has come for so long after the end, nothing is on its way."""

QUIET_AMONG_OTHERS_S: Final = 0.25
"""The same where others have sent too, whose queues a busy machine may be slow to empty."""

UNREAD_S: Final = 10.0
"""The longest wait for it, on a bus whose time stamps do not say what was sent before the end."""


class PlantNode:
    """Sends reference and feedback, waits for the status, applies the received commands.

    Args:
        scenario: the run.
        network: the frames of the run.
        send: sends a frame.
        recorder: gets every frame sent or received; None records nothing.
        reports: gets the plant's report of every tick; None records nothing.
        interaction: permitted commands during the run.
        local: the bus behind ``send``, for frames as bursts; None: frame by frame.

    Raises:
        ScenarioError: a reference beyond the range of its frame, an invalid plant, frames
            without a tick.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        send: Send,
        recorder: Recorder | None = None,
        reports: PlantRecorder | None = None,
        interaction: Interaction = UNTOUCHED,
        local: LocalBus | None = None,
    ) -> None:
        require_ticks(scenario, network)
        self.ticks: Final = scenario.ticks
        self._tick_ns = scenario.tick_ns
        self._outages = deque(scenario.outages)
        self._recorder = recorder
        self._others_send = False
        self._end = PlantEnd(
            scenario, network, send, recorder, reports, interaction.injectable, local
        )
        self._control = RunControl(interaction, scenario, self._end, send, SYSTEM_CLOCK)

    def carry(
        self, watchdog: Watchdog, tick: int, answer: Callable[[], object] | None = None
    ) -> int:
        """Carry one tick; see ``drive``.

        Args:
            watchdog: receives from the bus.
            tick: the tick.
            answer: lets a controller node in this process answer; None: another process has the
                controller node.

        Raises:
            SilentNodeError: the controller node is silent.
            BusLostError: the bus carries nothing any more.
            Interrupted: a stop was requested.
        """
        watchdog.stop.require_none()
        self._control.begin(tick, watchdog, self._overhear)
        self.offer(tick)
        if answer is not None:
            answer()
        self.collect(tick, watchdog)
        return tick + 1

    def offer(self, tick: int) -> None:
        """Start ``tick``: sample D*, send the reference and the feedback."""
        if self._recorder is not None:
            # So a killed process leaves every tick that it finished.
            self._recorder.flush()
            self._recorder.at(tick * self._tick_ns)
        self._end.sample(tick)
        self._end.send_sample()

    def repeat(self) -> None:
        """Send the offer again, for a controller that starts late; the log has one copy."""
        self._end.repeat()

    def collect(self, tick: int, watchdog: Watchdog) -> None:
        """Finish ``tick``: take the commands up to its status frame and advance the plant.

        Errors are those of ``Watchdog.receive``.
        """
        if self._outages and tick >= self._outages[0].start:
            self._end.expect_restart()
            watchdog.expect_restart()
            if tick in self._outages[0]:  # the controller has no power
                while (message := watchdog.glance(0.0)) is not None:
                    self._overhear(message)
                self._finish(tick, None, None)
                return
            self._outages.popleft()
        if self._end.bursts is not None:
            found = self._end.bursts.receive(tick)
            if found is not None:
                watchdog.hear()
                command_1, command_2, _ = found
                self._end.advance(
                    tick,
                    None if math.isnan(command_1) else command_1,
                    None if math.isnan(command_2) else command_2,
                )
                return
        commands: list[float | None] = [None, None]
        while True:
            message = watchdog.receive(tick)
            judged = self._end.judge(message, tick)
            if judged is None and not self._end.ends(message, tick):
                self._overhear(message)
                watchdog.go_on_waiting(tick)
                continue
            if self._recorder is not None:
                self._recorder.record(message, sent=False)
            if judged is None or judged[0] == COMMANDS:
                watchdog.hear()
                break
            at, record = judged
            if math.isfinite(record.value):
                commands[at] = record.value
        self._finish(tick, *commands)

    def _finish(self, tick: int, command_1: float | None, command_2: float | None) -> None:
        self._end.end_tick()
        self._end.advance(tick, command_1, command_2)
        self._control.applied()

    def _overhear(self, message: can.Message) -> None:
        """Note a frame of another sender, or one that comes between two ticks."""
        self._others_send = True
        if self._recorder is not None:
            self._recorder.record(message, sent=False)
        self._control.take(message)

    def record_the_rest(self, bus: NodeBus, clock: Clock) -> None:
        """Record unread frames of other senders at the end of the run."""
        if self._recorder is None:
            return
        quiet_s = QUIET_AMONG_OTHERS_S if self._others_send else QUIET_S
        end_s, deadline_ns = clock.stamp_s(), clock.now_ns() + round(UNREAD_S * NS_PER_S)
        with suppress(can.CanError):
            while clock.now_ns() < deadline_ns:
                message = bus.recv(quiet_s)
                if message is None or message.timestamp > end_s:
                    return
                self._recorder.record(message, sent=False)

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        refused = self._control.refused
        return self._end.rejected() | ({CONTROL: {"refused": refused}} if refused else {})


def require_ticks(scenario: Scenario, network: Network) -> None:
    """Refuse frames without a tick signal.

    Raises:
        ScenarioError: a frame without a tick signal.
    """
    if not network.has_ticks:
        raise ScenarioError(
            f"scenario {scenario.name}: network.tick: must name the signal that counts the "
            "ticks in every message, or the run be in real time (can-rig run --realtime): in "
            "lockstep a frame must say which tick it is of"
        )


class AnsweringNode(ABC):
    """A node that answers each tick's frames, unless the scenario takes its power.

    Attributes:
        ticks: the number of ticks of the whole run.
    """

    def __init__(self, scenario: Scenario, network: Network) -> None:
        self.ticks: Final = scenario.ticks
        self._feedback_codec = network.feedback
        self._outages = deque(scenario.outages)
        self._tick = 0  # the next one

    @property
    def tick(self) -> int:
        """The tick that is answered next, or passes without power."""
        return self._tick

    def take(self, message: can.Message) -> bool:
        """Receive a frame; returns True if the frame completed a tick, which is then answered."""
        if self._follow(message):
            return False
        return self._overhear(message) if self._has_no_power else self._receive(message)

    @abstractmethod
    def _follow(self, message: can.Message) -> bool:
        """Whether a frame announces a command of an operator, which is then obeyed."""

    @abstractmethod
    def _receive(self, message: can.Message) -> bool:
        """See ``take``."""

    @abstractmethod
    def _restart(self, state_survives: bool) -> None:
        """Begin as after power-up, with the saved state or from nothing."""

    @property
    def _has_no_power(self) -> bool:
        return bool(self._outages) and self._tick in self._outages[0]

    def _go_on(self, tick: int) -> None:
        """Turn to ``tick``, where an outage may end."""
        self._tick = tick
        if self._outages and tick == self._outages[0].stop:
            self._restart(self._outages.popleft().state_survives)

    def _overhear(self, message: can.Message) -> bool:
        """Follow the ticks without power; returns whether ``message`` ended one.

        The node sends and keeps no frame. Where the bus dropped frames of the outage, the
        next intact feedback says how far the run is, the end of the outage at most.
        """
        if message.arbitration_id != self._feedback_codec.frame_id:
            return False
        record = Receiver(self._feedback_codec).accept(message)
        if record is None:
            return False
        ahead, left = ticks_ahead(record.tick, self._tick), self._outages[0].stop - self._tick
        if not 0 <= ahead <= left:
            return False
        self._go_on(self._tick + min(ahead + 1, left))
        return True

    def carry(self, watchdog: Watchdog, _tick: int = 0) -> int:
        """Answer one tick; see ``drive``.

        Raises:
            SilentNodeError: the plant node is silent.
            BusLostError: the bus carries nothing any more.
            Interrupted: a stop was requested.
        """
        watchdog.stop.require_none()
        self.serve(watchdog)
        return self.tick

    def serve(self, watchdog: Watchdog) -> None:
        """Wait for one tick's feedback and answer the tick; errors as of ``Watchdog.receive``."""
        while not self.take(watchdog.receive(self.tick)):
            watchdog.go_on_waiting(self.tick)
        watchdog.hear()


class Actuation(Protocol):
    """The recorded timing of commands, for replay."""

    def begin(self, tick: int, controller: NodeController) -> bool:
        """Tell the controller the active commands from ``tick``; True for an answered sample."""

    def send(self, tick: int, commands: tuple[float, float]) -> None:
        """Note the commands of a tick."""


class ControllerNode(AnsweringNode):
    """Answers each feedback frame with two commands and a status.

    Args:
        scenario: the run.
        network: the frames of the run.
        send: sends a frame.
        controller: starts the controller, again after each outage.
        actuation: command timing of a recorded real-time run; None: every answer is in time.
        local: the bus behind ``send``, for frames as bursts; None: frame by frame. A node with
            bursts follows no command of an operator.

    Raises:
        ScenarioError: the design fails.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        send: Send,
        controller: InNode,
        actuation: Actuation | None = None,
        local: LocalBus | None = None,
    ) -> None:
        super().__init__(scenario, network)
        self._actuation = actuation
        self._end = ControllerEnd(scenario, network, send, local)
        self._followed = FollowedFaults(scenario, self._end.faults)
        self._powered_up = partial(controller.start, scenario, network)
        self._begin()

    def _begin(self) -> None:
        self._controller = self._powered_up()
        self._reference_now = NO_RECORD
        self._speed_now = math.nan
        self._expected: int | None = None  # the first contact sets the tick
        self._first: dict[int, can.Message] = {}  # heard before the first contact, by identifier

    def _restart(self, state_survives: bool) -> None:
        """See ``AnsweringNode``."""
        self._end.restart()
        saved = self._controller.saved() if state_survives else b""
        self._begin()
        self._controller.restore(saved)

    def _follow(self, message: can.Message) -> bool:
        """See ``AnsweringNode``."""
        return self._end.bursts is None and self._followed.take(message, self._tick)

    def serve(self, watchdog: Watchdog) -> None:
        """See ``AnsweringNode``."""
        bursts = None if self._has_no_power else self._end.bursts
        if bursts is not None and self._expected is not None:
            found = bursts.receive(self._expected)
            if found is not None:
                *speed, reference, measurement = found
                if speed:
                    self._speed_now = speed[0]
                self._reference_now = NO_RECORD
                self._respond(self._expected, reference, measurement)
                self._go_on(self._expected)
                watchdog.hear()
                return
        super().serve(watchdog)

    def _receive(self, message: can.Message) -> bool:
        """See ``AnsweringNode``."""
        if self._expected is None and not self._first_contact(message):
            return False
        receiver = self._end.receiver_of(message)
        if receiver is None:
            self._end.witnesses.take(message, self._expected)
            return False
        record = receiver.accept(message, self._expected)
        if record is None:  # without a frame of the speed the controller keeps the last speed
            return False
        if receiver is self._end.feedback:
            self._answer(record.tick, record.value)
            return True
        if receiver is self._end.reference:
            self._reference_now = record
        else:
            self._speed_now = record.value
        return False

    def _first_contact(self, message: can.Message) -> bool:
        """Whether ``message`` is the first feedback: intact, and of the tick of the reference.

        A forged frame has the right CRC with probability 1/256, and no expected tick exists yet to
        reject the frame. First contact therefore needs two consistent frames; before first contact
        no protection checker sees any frame. A damaged reference does not replace an intact one.
        """
        reference, feedback = self._end.reference, self._end.feedback
        receiver = self._end.receiver_of(message)
        if receiver is reference:
            if Receiver(reference.codec).accept(message) is not None:
                self._first[message.arbitration_id] = message
        elif receiver not in {None, feedback} or self._end.witnesses.concerns(message):
            self._first[message.arbitration_id] = message
        elif receiver is feedback and (first := self._first.get(reference.codec.frame_id)):
            pair = ((reference, first), (feedback, message))
            one, other = (Receiver(receiver.codec).accept(frame) for receiver, frame in pair)
            if one is not None and other is not None and one.tick == other.tick:
                self._reference_now, self._expected = one, one.tick
                while self._outages and self._outages[0].stop <= tick_from(one.tick, self._tick):
                    self._outages.popleft()  # of before the start of a log
                for earlier in self._first.values():
                    self._receive(earlier)
                return True
        return False

    @property
    def expected(self) -> int | None:
        """The tick of the next expected frames; None before the first contact."""
        return self._expected

    def miss(self) -> None:
        """Skip the expected tick without feedback: the firmware holds, and reports the miss.

        In lockstep, time stands still until the feedback arrives; callers that know about passed
        ticks report each with this method.
        """
        if self._has_no_power or self._expected is None:
            self._go_on(self._tick + 1)
            return
        self._answer(self._expected % WIRE_TICKS, math.nan)

    def _answer(self, wire_tick: int, measurement: float) -> None:
        tick = tick_from(wire_tick, self._tick)
        now, self._reference_now = self._reference_now, NO_RECORD  # its number comes again
        reference = now.value if now.tick == wire_tick else math.nan  # none: hold, and say so
        self._respond(tick, reference, measurement)
        self._end.end_tick()
        self._go_on(tick + 1)

    def _respond(self, tick: int, reference: float, measurement: float) -> None:
        if self._actuation is not None and not self._actuation.begin(tick, self._controller):
            reference = measurement = math.nan
        heard = self._end.witnesses.end_tick(tick)
        answer = self._controller.step(Inputs(reference, measurement, self._speed_now, heard))
        self._speed_now = math.nan
        if self._actuation is not None:
            self._actuation.send(tick, (answer.command_1, answer.command_2))
        self._end.send_answer(tick, answer)
        self._expected = tick + 1

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        return self._end.rejected()


class EcuNode(AnsweringNode):
    """Like ``ControllerNode``, but ``ecu`` processes the frames."""

    def __init__(self, scenario: Scenario, network: Network, send: Send, ecu: Ecu) -> None:
        super().__init__(scenario, network)
        self._send = send
        self._ecu = ecu
        speed = () if network.speed is None else (network.speed,)
        further = (codec for _, codec in heard_by_law(scenario, network))
        self._inputs = (network.reference, network.feedback, *speed, *further)
        self._wanted = {
            flagged(codec.frame_id, codec.extended, codec.fd)
            for codec in (*network.inputs, *network.witnesses)
        }
        self._channels = {
            flagged(codec.frame_id, codec.extended, codec.fd): channel
            for channel, codec in enumerate((network.command_1, network.command_2))
        }
        self._faults = FrameFaults(scenario, network)
        self._followed = FollowedFaults(scenario, self._faults)
        self._rejected: Rejected = {}

    def _follow(self, message: can.Message) -> bool:
        """See ``AnsweringNode``."""
        ours = not (message.is_extended_id or message.is_remote_frame or message.is_error_frame)
        return ours and self._followed.take(message, self._tick)

    def _restart(self, state_survives: bool) -> None:
        """See ``AnsweringNode``."""
        self._rejected = self.rejected()
        self._faults.restart()
        self._ecu.restart(state_survives)

    def _receive(self, message: can.Message) -> bool:
        """Pass a frame to the program, send a completed tick's answer; True after an answer."""
        number = flagged(message.arbitration_id, message.is_extended_id, message.is_fd)
        if message.is_remote_frame or message.is_error_frame or number not in self._wanted:
            return False
        sent = self._ecu.take(number, bytes(message.data))
        for number, data in sent:
            frame_id, extended, fd = unflagged(number)
            own = can.Message(0.0, frame_id, extended, data=data, is_fd=fd)
            frames = [own]
            if number in self._channels:
                frames = self._faults.on_the_wire(own, self._channels[number], self._tick)
            for frame in frames:
                self._send(frame)
        if sent:
            self._go_on(self._tick + 1)
        return bool(sent)

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        counts = self._ecu.counts()
        parts = (counts[i : i + COUNTS] for i in range(0, len(counts), COUNTS))
        pairs = zip(self._inputs, parts, strict=True)
        now = {codec.name: rejected(part) for codec, part in pairs}
        return all_rejected(self._rejected, now)


@contextmanager
def lockstep_controller(
    scenario: Scenario,
    network: Network,
    send: Send,
    controller: Supplied,
    local: LocalBus | None = None,
) -> Iterator[ControllerNode | EcuNode]:
    """The controller node in lockstep; see ``ControllerNode``."""
    if isinstance(controller, InNode):
        yield ControllerNode(scenario, network, send, controller, local=local)
        return
    ecu = controller.start()
    try:
        yield EcuNode(scenario, network, send, ecu)
    finally:
        ecu.close()


def in_real_time(controller: Supplied) -> InNode:
    """The controller of a node by the wall clock.

    Raises:
        ExportError: a whole node, whose receive rules support lockstep only.
    """
    if isinstance(controller, WholeNode):
        raise ExportError("real time: the controller must be python or c")
    return controller
