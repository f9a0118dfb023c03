"""Both nodes' ends of a tick's frames.

The plant's end sends reference and feedback and judges the three answer frames; the controller's
end receives the plant's frames and sends the answer.
"""

import math
from collections import Counter
from collections.abc import Sequence
from functools import partial
from itertools import chain
from typing import Final

import can
import numpy as np

from can_rig.buses.local.bus import LocalBus
from can_rig.controllers.protocol import Answer, Status, said
from can_rig.frames.codec import MessageCodec, Receiver, Record, Transmitter, ticks_ahead
from can_rig.frames.network import Network
from can_rig.nodes.bursts import Bursts
from can_rig.nodes.bus_access import PersistentSender, Send
from can_rig.nodes.recording import PlantRecorder, Recorder
from can_rig.plant.faults.frame_faults import SENSOR_PLACE, FrameFaults
from can_rig.plant.simulated import SimulatedPlant
from can_rig.plant.witnesses import SensorFrames, hearing_of
from can_rig.scenario.driving import speeds_at_ticks
from can_rig.scenario.reference import reference, refuse_saturation
from can_rig.scenario.settings import Scenario

COMMANDS: Final = 2
"""What is received is numbered: the commands first, then the status."""


def bursts_of(
    network: Network,
    send: Send,
    codecs: Sequence[MessageCodec],
    receivers: Sequence[Receiver],
    healthy: bool,
    local: LocalBus | None,
    lines: Recorder | None = None,
) -> Bursts | None:
    """Access to the frames as bursts, where bus, network and sender allow bursts.

    ``healthy`` says that no frame fault changes the frames of ``codecs``; see ``Bursts``.
    """
    if local is None or not healthy or not local.bursts or not network.is_the_rigs:
        return None
    if network.witnesses:  # a tick then has as many frames as are due
        return None
    assert isinstance(send, PersistentSender)
    return Bursts(local, send, codecs, receivers, lines)


Rejected = dict[str, dict[str, int]]
"""Per message, how many frames were not used and why."""


def all_rejected(before: Rejected, now: Rejected) -> Rejected:
    """The counts of a node from before its restart and since."""
    return {name: dict(Counter(before.get(name)) + Counter(now[name])) for name in now}


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
        local: the bus behind ``send``, for frames as bursts; None: frame by frame.

    Raises:
        ScenarioError: a reference beyond the range of its frame, an invalid plant.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        send: Send,
        log: Recorder | None,
        reports: PlantRecorder | None = None,
        changing: bool = False,
        local: LocalBus | None = None,
    ) -> None:
        self.plant: Final = SimulatedPlant(scenario, changing, network)
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
        self._witnesses = SensorFrames(network, self._faults)
        self._receivers = tuple(
            Receiver(codec) for codec in (network.command_1, network.command_2, network.status)
        )
        self._by_id = {each.codec.frame_id: at for at, each in enumerate(self._receivers)}
        self._offered: tuple[can.Message, ...] = ()
        self._restarted = False  # and no status frame used since
        self._sampled: tuple[int, tuple[float, float, float]] = (0, (0.0, 0.0, 0.0))
        self.bursts: Final = bursts_of(
            network,
            send,
            network.inputs,
            self._receivers,
            not self._faults.concerns(SENSOR_PLACE),
            local,
            log,
        )
        """Access to the frames as bursts; None: frame by frame."""

    def change_faults(self, scenario: Scenario) -> None:
        """From the next tick on, the faults of ``scenario``."""
        self.plant.change_faults(scenario)
        self._faults.change(scenario)

    def sample(self, tick: int) -> None:
        """Measure D* of ``tick`` and pack its frames."""
        if self.bursts is not None:
            wanted, measured = self._reference.item(tick), self.plant.measure()
            speed = () if self._send_speed is None else (self._speeds.item(tick),)
            self._sampled = tick, (*speed, wanted, measured, 0.0)[:3]
            return
        wanted = self._reference.item(tick) + self.reference_offset
        reference = self._send_reference.frame(wanted, tick)
        own = self._send_feedback.frame(self.plant.measure(), tick)
        feedback = [own]
        if self._faults.concerns(SENSOR_PLACE):
            feedback = self._faults.on_the_wire(
                own, SENSOR_PLACE, tick, self._send_nothing.frame(math.nan, tick)
            )
        witnesses = self._witnesses.of(self.plant.said, tick)
        self._offered = (*witnesses, reference, *feedback)
        if self._send_speed is not None:
            self._offered = (self._send_speed.frame(self._speeds.item(tick), tick), *self._offered)

    def send_sample(self) -> None:
        """Send what was sampled."""
        if self.bursts is not None:
            self.bursts.send(*self._sampled)
            return
        for message in self._offered:
            self._send(message)
            if self._log is not None:
                self._log.record(message, sent=True)

    def repeat(self) -> None:
        """Send the offer again, for a controller that starts late; the log has one copy."""
        if self.bursts is not None:
            self.bursts.repeat()
        for message in self._offered:
            self._send(message)

    def judge(self, message: can.Message, tick: int) -> tuple[int, Record] | None:
        """Number and content of a valid frame of ``tick``; returns None for every other frame."""
        at = self._by_id.get(message.arbitration_id)
        if at is None:
            return None
        record = self._receivers[at].accept(message, tick)
        if record is None:
            return None
        self._restarted &= at != COMMANDS
        return at, record

    def ends(self, message: can.Message, tick: int) -> bool:
        """Whether a rejected frame is the status of ``tick`` by a controller that began again.

        Its alive counter begins again, so the checker may reject the first status frames. They end
        the tick all the same; their content is not used.
        """
        status = self._receivers[COMMANDS].codec
        return (
            self._restarted
            and message.arbitration_id == status.frame_id
            and Receiver(status).accept(message, tick) is not None
        )

    def expect_restart(self) -> None:
        """The controller has no power, and begins again later."""
        self._restarted = True
        if self.bursts is not None:
            self.bursts.let_receivers_know()

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


class ControllerEnd:
    """The receivers of reference, feedback and speed, and the senders of the answer.

    Args:
        scenario: the run; its frame faults act on the answer.
        network: the frames of the run.
        send: sends a frame.
        local: the bus behind ``send``, for frames as bursts.
    """

    def __init__(
        self, scenario: Scenario, network: Network, send: Send, local: LocalBus | None = None
    ) -> None:
        self._network, self._send, self._local = network, send, local
        self.faults: Final = FrameFaults(scenario, network)
        """Those of the answer."""
        self._rejected: Rejected = {}
        self._powered_up = partial(hearing_of, scenario, network)
        self._begin()

    def restart(self) -> None:
        """Begin again: the first frames sent have counter 0, the receivers have heard nothing."""
        self._rejected = self.rejected()
        self.faults.restart()
        self._begin()

    def _begin(self) -> None:
        network, send, local = self._network, self._send, self._local
        self.reference = Receiver(network.reference)
        self.feedback = Receiver(network.feedback)
        self.speed = None if network.speed is None else Receiver(network.speed)
        both = (self.reference, self.feedback)
        self._receivers = both if self.speed is None else (self.speed, *both)
        self._by_id = {each.codec.frame_id: each for each in self._receivers}
        self.witnesses = self._powered_up()
        """Those of the further sensors."""
        self._commands = (Transmitter(network.command_1), Transmitter(network.command_2))
        self._status = Transmitter(network.status)
        answers = (network.command_1, network.command_2, network.status)
        healthy = not (self.faults.concerns(0) or self.faults.concerns(1))
        self.bursts = bursts_of(network, send, answers, self._receivers, healthy, local)
        """Access to the frames as bursts; None: frame by frame."""

    def send_answer(self, tick: int, answer: Answer) -> None:
        """Send commands and status of ``tick``."""
        command_1, command_2, *_ = answer
        status = said(answer)
        if self.bursts is not None:
            self.bursts.send(tick, (command_1, command_2, status.fault_estimate), *status[1:])
            return
        self.send_commands(tick, command_1, command_2)
        self.send_status(tick, status)

    def send_commands(self, tick: int, command_1: float, command_2: float) -> None:
        """Send both commands of ``tick``, after the scheduled frame faults."""
        frames = [
            self.faults.on_the_wire(transmitter.frame(command, tick), channel, tick)
            for channel, (transmitter, command) in enumerate(
                zip(self._commands, (command_1, command_2), strict=True)
            )
        ]
        for frame in chain(*frames):
            self._send(frame)

    def send_status(self, tick: int, status: Status) -> None:
        """The status, which closes ``tick``."""
        self._send(self._status.frame(status.fault_estimate, tick, *status[1:]))

    def receiver_of(self, message: can.Message) -> Receiver | None:
        """The receiver of a frame of every tick; None: another frame."""
        return self._by_id.get(message.arbitration_id)

    def end_tick(self) -> None:
        """No more of this tick comes."""
        for receiver in self._receivers:
            receiver.end_tick()

    def rejected(self) -> Rejected:
        """Per message, how many frames were not used and why."""
        receivers = (*self._receivers, *self.witnesses.receivers)
        now = {receiver.codec.name: receiver.rejected for receiver in receivers}
        return all_rejected(self._rejected, now)
