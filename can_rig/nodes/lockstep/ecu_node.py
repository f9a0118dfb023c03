"""The controller node in lockstep as a separate C program, on this machine or another.

This module handles the bus: received frames go to the program, and the program's frames go to the
bus after the scheduled frame faults.
"""

from __future__ import annotations

import can

from can_rig.export.ecus import COUNTS, Ecu, rejected
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import Send
from can_rig.nodes.lockstep.answering import AnsweringNode
from can_rig.nodes.operator.following import FollowedFaults
from can_rig.plant.faults.frame_faults import FrameFaults
from can_rig.scenario.settings import Scenario


class EcuNode(AnsweringNode):
    """Like ``ControllerNode``, but ``ecu`` processes the frames."""

    def __init__(self, scenario: Scenario, network: Network, send: Send, ecu: Ecu) -> None:
        self.ticks = scenario.ticks
        self._send = send
        self._ecu = ecu
        speed = () if network.speed is None else (network.speed,)
        self._inputs = (network.reference, network.feedback, *speed)
        self._wanted = {codec.frame_id for codec in network.on_the_bus[: network.offered]}
        commands = (network.command_1, network.command_2)
        self._channels = {codec.frame_id: channel for channel, codec in enumerate(commands)}
        self._faults = FrameFaults(scenario, network)
        self._followed = FollowedFaults(scenario, self._faults)
        self._tick = 0  # the next one

    @property
    def tick(self) -> int:
        """The tick that is answered next."""
        return self._tick

    def take(self, message: can.Message) -> bool:
        """Pass a frame to the program, send a completed tick's answer; True after an answer."""
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            return False
        if message.arbitration_id not in self._wanted:
            self._followed.take(message, self._tick)
            return False
        sent = self._ecu.take(message.arbitration_id, bytes(message.data))
        for frame_id, data in sent:
            own = can.Message(0.0, frame_id, False, data=data)
            frames = [own]
            if frame_id in self._channels:
                frames = self._faults.on_the_wire(own, self._channels[frame_id], self._tick)
            for frame in frames:
                self._send(frame)
        self._tick += bool(sent)
        return bool(sent)

    def close(self) -> None:
        """End the program."""
        self._ecu.close()

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        counts = self._ecu.counts()
        parts = (counts[i : i + COUNTS] for i in range(0, len(counts), COUNTS))
        pairs = zip(self._inputs, parts, strict=True)
        return {codec.name: rejected(part) for codec, part in pairs}
