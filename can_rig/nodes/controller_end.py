"""The controller's end of a tick's frames: receives the plant's frames and sends three."""

from __future__ import annotations

import math
from itertools import chain
from typing import Final

import can

from can_rig.frames.codec import Record
from can_rig.frames.endpoints import Receiver, Transmitter
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import Send
from can_rig.plant.faults.frame_faults import FrameFaults
from can_rig.scenario.driving import controls
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import PYTHON_LAW, Firmware, Law
from firmware_model.target.structs import Record as Memory


class ControllerEnd:
    """The receivers of reference, feedback and speed, and the senders of the answer.

    Args:
        scenario: the run; its frame faults act on the answer.
        network: the frames of the run.
        send: sends a frame.
    """

    def __init__(self, scenario: Scenario, network: Network, send: Send) -> None:
        self.reference: Final = Receiver(network.reference)
        self.feedback: Final = Receiver(network.feedback)
        self.speed: Final = None if network.speed is None else Receiver(network.speed)
        self._send = send
        self._commands = (Transmitter(network.command_1), Transmitter(network.command_2))
        self._status = Transmitter(network.status)
        self.faults: Final = FrameFaults(scenario, network)
        """Those of the answer."""

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

    def send_status(
        self, tick: int, estimate: float, mode: int, fault_state: int, verdict: int
    ) -> None:
        """The status, which closes ``tick``."""
        self._send(self._status.frame(estimate, tick, mode, fault_state, verdict))

    def is_speed(self, message: can.Message) -> bool:
        """Whether ``message`` is a speed frame; False on a network without speed frames."""
        return self.speed is not None and message.arbitration_id == self.speed.codec.frame_id

    def speed_of(self, message: can.Message, tick: int | None) -> Record | None:
        """The content of a frame of the speed; see ``Receiver.accept``."""
        assert self.speed is not None
        return self.speed.accept(message, tick)

    def end_tick(self) -> None:
        """No more of this tick comes."""
        for receiver in self._receivers:
            receiver.end_tick()

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        return {receiver.codec.name: receiver.rejected for receiver in self._receivers}

    @property
    def _receivers(self) -> tuple[Receiver, ...]:
        both = (self.reference, self.feedback)
        return both if self.speed is None else (self.speed, *both)


def started(scenario: Scenario, network: Network, law: Law = PYTHON_LAW) -> tuple[Memory, Firmware]:
    """The controller's table and the firmware at rest, compiled before the first tick.

    ``law`` is the implementation of the control law.

    Raises:
        ScenarioError: the design fails.
    """
    of = controls(scenario, network)
    firmware = Firmware(of.table, law, of.schedule)
    firmware.step(math.nan, math.nan)
    firmware.reset(0.0)
    return of.table, firmware
