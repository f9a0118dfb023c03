"""What was done to a run while it went on, as its log has it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import can

from can_rig.frames import control
from can_rig.frames.network import Network
from can_rig.logs.frames import EXTENDED, Frames
from can_rig.nodes.bus_access import NodeBus
from can_rig.plant.injection import Injection
from can_rig.scenario.settings import Scenario


class Touch(NamedTuple):
    """One ``RIG_CONTROL`` of a log."""

    answers: int
    """How many frames of the controller node the plant node had received before."""
    tick: int
    """From which it acts."""
    message: can.Message


def touches(chunks: Iterable[Frames], network: Network) -> list[Touch]:
    """The commands in a log, in their order."""
    frame_id, _, _ = control.identifiers()
    feedback = network.feedback.frame_id
    answering = {each.frame_id for each in (network.command_1, network.command_2, network.status)}
    found, answers, tick = [], 0, 0
    for chunk in chunks:
        ours = chunk[~chunk.has(EXTENDED)]
        if not (ours.arbitration_id == frame_id).any():
            answers += int(sum((ours.arbitration_id == each).sum() for each in answering))
            tick += int((ours.arbitration_id == feedback).sum())
            continue
        for message in ours.messages():
            answers += message.arbitration_id in answering
            tick += message.arbitration_id == feedback
            if message.arbitration_id == frame_id:
                found.append(Touch(answers, tick, message))
    return found


@dataclass(frozen=True)
class Done:
    """A scenario with what was done to a run of it.

    ``moved`` says whether the reference was moved, which no fault of a scenario does.
    """

    scenario: Scenario
    moved: bool


def done(scenario: Scenario, told: Iterable[Touch]) -> Done:
    """The scenario whose scheduled faults are its own and those that were injected."""
    injection, moved, sequence = Injection(scenario), False, 0
    for touch in told:
        command = control.read_command(touch.message, sequence)
        if command is None:  # it was refused
            continue
        sequence = (sequence + 1) % control.SEQUENCES
        if command.action == "INJECT":
            injection.inject(command, touch.tick)
        elif command.action == "CLEAR":
            injection.clear(command.place, touch.tick)
        moved |= command.action == "MOVE_REFERENCE"
    return Done(injection.scenario, moved)


class OperatedBus:
    """A bus on which the commands of a log come where they came.

    Args:
        bus: the plant node's.
        network: its frames.
        told: the commands.
    """

    def __init__(self, bus: NodeBus, network: Network, told: Iterable[Touch]) -> None:
        self._bus = bus
        self._told = deque(told)
        self._answers = 0
        self._answering = {
            each.frame_id for each in (network.command_1, network.command_2, network.status)
        }
        self.channel_info = getattr(bus, "channel_info", "")

    def send(self, msg: can.Message) -> None:
        """As the bus."""
        self._bus.send(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next command, where its turn has come; otherwise as the bus."""
        if self._told and self._told[0].answers == self._answers:
            return self._told.popleft().message
        if timeout == 0.0:
            return None  # between two ticks nothing else comes
        message = self._bus.recv(timeout)
        if message is not None:
            self._answers += message.arbitration_id in self._answering
        return message
