"""Commands in the log of a run: read from the log, and given to a run again at their places."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import can
import numpy as np

from can_rig.frames import operator_frames
from can_rig.frames.network import Network
from can_rig.logs.frames import EXTENDED, Frames
from can_rig.nodes.bus_access import NodeBus
from can_rig.plant.faults.injection import FAULT_ACTIONS, Injection
from can_rig.scenario.settings import Scenario


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


class Touches:
    """The commands in a log, in their order: ``found``, of what has passed ``watching``."""

    def __init__(self, network: Network) -> None:
        self.found: Final[list[Touch]] = []
        self._command = operator_frames.identifiers().control
        self._reference = network.reference.frame_id  # one a tick; others may come again
        self._its = [self._command, *(each.frame_id for each in network.by_role)]
        self._frames = self._tick = 0

    def watching(self, chunks: Iterable[Frames]) -> Iterator[Frames]:
        """The same chunks, so one pass over a log serves every reader."""
        for chunk in chunks:
            self._add(chunk)
            yield chunk

    def _add(self, chunk: Frames) -> None:
        ours = chunk[~chunk.has(EXTENDED) & np.isin(chunk.arbitration_id, self._its)]
        if not (ours.arbitration_id == self._command).any():
            self._frames += len(ours)
            self._tick += int((ours.arbitration_id == self._reference).sum())
            return
        for message in ours.messages():
            if message.arbitration_id == self._command:
                self.found.append(Touch(self._frames, self._tick, message))
                continue
            self._frames += 1
            self._tick += message.arbitration_id == self._reference


def touches(chunks: Iterable[Frames], network: Network) -> list[Touch]:
    """The commands in a log, for callers without other use for the log."""
    reader = Touches(network)
    deque(reader.watching(chunks), maxlen=0)
    return reader.found


@dataclass(frozen=True)
class Done:
    """A scenario with the commands of a run.

    ``moved`` says whether a command moved the reference, which no scenario fault can express.
    """

    scenario: Scenario
    moved: bool


def done(scenario: Scenario, told: Iterable[Touch]) -> Done:
    """The scenario, with the injected faults after the scheduled faults."""
    injection, moved, sequence = Injection(scenario), False, 0
    for touch in told:
        command = operator_frames.read_command(touch.message, sequence)
        if command is None:  # it was refused
            continue
        sequence = (sequence + 1) % operator_frames.SEQUENCES
        if command.action in FAULT_ACTIONS:
            injection.obey(command, touch.tick)
        moved |= command.action == "MOVE_REFERENCE"
    return Done(injection.scenario, moved)
