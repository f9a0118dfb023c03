"""The plant node: an I/O shell around ``plant``. It owns virtual time and writes the log."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import can

from can_rig.frames.endpoints import Receiver, Transmitter
from can_rig.frames.network import Network
from can_rig.nodes.lockstep import Interrupted, Sender, Waiting, Watchdog
from can_rig.nodes.recorder import Recorder
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.reference import on_the_bus
from can_rig.scenario.settings import Scenario

QUIET_S: Final = 0.02  # when nothing has come for so long after the end, nothing is on its way
UNREAD_S: Final = 2.0  # on a bus whose time stamps do not tell what was sent before the end
NOT_OURS: Final[tuple[int, Receiver | None]] = (-1, None)


class PlantNode:
    """Sends reference and feedback, waits for the status, applies the commands that came.

    Args:
        scenario: the run.
        network: its frames.
        bus: where to send and, without ``watchdog``, receive.
        recorder: gets every frame sent or seen; None records nothing.
        waiting: how long the bus may refuse a frame.

    Raises:
        ScenarioError: a reference that does not fit its frame.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        bus: can.BusABC,
        recorder: Recorder | None,
        waiting: Waiting = Waiting(),  # noqa: B008 (frozen)
    ) -> None:
        self.ticks = scenario.ticks
        self._plant = SimulatedPlant(scenario)
        self._reference = on_the_bus(scenario, network)
        self._bus = bus
        self.send = Sender(bus, waiting.silence_s)
        self._recorder = recorder
        self._send_reference = Transmitter(network.reference)
        self._send_feedback = Transmitter(network.feedback)
        self._commands = (Receiver(network.command_1), Receiver(network.command_2))
        self._status = Receiver(network.status)
        self._offered: tuple[can.Message, ...] = ()
        self._by_id: dict[int, tuple[int, Receiver | None]] = {
            receiver.codec.frame_id: (index, receiver)
            for index, receiver in enumerate((*self._commands, self._status))
        }

    def run(self, watchdog: Watchdog, on_tick: Callable[[int], None]) -> int:
        """Run to the end or to a stop request; the number of ticks completed.

        Raises:
            SilentNodeError: the controller node is silent.
            BusLostError: the bus carries nothing any more.
        """
        for tick in range(self.ticks):
            try:
                if watchdog.stop.wanted:
                    return tick
                self.offer(tick)
                self.collect(tick, watchdog)
            except Interrupted:
                return tick
            on_tick(tick + 1)
        return self.ticks

    def offer(self, tick: int) -> None:
        """Start ``tick``: sample D*, send the reference and the feedback."""
        if self._recorder is not None:
            self._recorder.begin_tick(tick)
        self._sample(tick)
        self._send_sample()

    def _sample(self, tick: int) -> None:
        self._offered = (
            self._send_reference.frame(self._reference[tick], tick),
            self._send_feedback.frame(self._plant.measure(), tick),
        )

    def _send_sample(self) -> None:
        for message in self._offered:
            self.send(message)
            if self._recorder is not None:
                self._recorder.record(message, sent=True)

    def repeat(self) -> None:
        """Send the offer again, to a controller that was not there yet; the log has it once."""
        for message in self._offered:
            self.send(message)

    def collect(self, tick: int, watchdog: Watchdog) -> None:
        """Finish ``tick``: take the commands up to its status frame and advance the plant.

        Raises:
            SilentNodeError, BusLostError, Interrupted: see ``Watchdog.receive``.
        """
        commands: list[float | None] = [None, None]
        while True:
            message = watchdog.receive(tick)
            if self._recorder is not None:
                self._recorder.record(message, sent=False)
            index, receiver = self._by_id.get(message.arbitration_id, NOT_OURS)
            record = receiver.accept(message, tick) if receiver is not None else None
            if record is None:
                watchdog.go_on_waiting(tick)
                continue
            if index == len(commands):
                watchdog.hear()
                break
            if math.isfinite(record.value):
                commands[index] = record.value
        for receiver in self._commands:
            receiver.end_tick()
        self._plant.advance(tick, *commands)

    def record_the_rest(self) -> None:
        """Put in the log what others had sent by the end and was not read yet."""
        if self._recorder is None:
            return
        end_s, deadline_s = time.time(), time.monotonic() + UNREAD_S
        with suppress(can.CanError):
            while time.monotonic() < deadline_s:
                message = self._bus.recv(QUIET_S)
                if message is None or message.timestamp > end_s:
                    return
                self._recorder.record(message, sent=False)

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        receivers = (*self._commands, self._status)
        return {receiver.codec.name: receiver.rejected for receiver in receivers}
