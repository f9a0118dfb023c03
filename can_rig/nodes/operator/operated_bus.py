"""Commands of a log, given to a run again where they came."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import can

from can_rig.frames.network import Network
from can_rig.nodes.bus_access import NodeBus


class Touch(NamedTuple):
    """One ``RIG_CONTROL`` of a log."""

    after: int
    """How many frames of the network were sent and received before."""
    tick: int
    """From which it acts."""
    message: can.Message


class OperatedBus:
    """A bus that delivers the commands of a log at their recorded places.

    Args:
        bus: the plant node's bus.
        network: the frames of the run.
        told: the commands.
    """

    def __init__(self, bus: NodeBus, network: Network, told: Iterable[Touch]) -> None:
        self._bus = bus
        self._told = deque(told)
        self._frames = 0
        self._network = {each.frame_id for each in network.by_role}
        self.channel_info = getattr(bus, "channel_info", "")

    def send(self, msg: can.Message) -> None:
        """As the bus."""
        self._bus.send(msg)
        self._frames += msg.arbitration_id in self._network

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next command, where its turn has come; otherwise as the bus."""
        if self._told and self._told[0].after <= self._frames:
            return self._told.popleft().message
        if timeout == 0.0:
            return None  # between two ticks nothing else comes
        message = self._bus.recv(timeout)
        if message is not None:
            self._frames += message.arbitration_id in self._network
        return message
