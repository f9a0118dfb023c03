"""Commands to a running simulation: sent to a plant node, read from a log, given to a run again."""

import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import can
import numpy as np

from can_rig.errors import BusError, RigError, one_line
from can_rig.frames import operator_frames
from can_rig.frames.network import Network
from can_rig.logs.frames import EXTENDED, Frames
from can_rig.nodes.bus_access import SYSTEM_CLOCK, NodeBus, TolerantBus
from can_rig.plant.faults.injection import FAULT_ACTIONS, Injection, require_possible
from can_rig.scenario.settings import Scenario


class Touch(NamedTuple):
    """One ``RIG_CONTROL`` of a log."""

    after: int
    """How many frames of the network were sent and received before."""
    tick: int
    """From which it acts."""
    message: can.Message


class OperatedBus:
    """A bus that delivers the commands of a log at their recorded places."""

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


WITHIN_S: Final = 1.0
"""A plant node says 20 times a second how it stands to commands."""


def operate(bus: can.BusABC, name: str, command: operator_frames.Command) -> None:
    """Send ``command`` on the bus called ``name``, and wait until the plant node obeys.

    Raises:
        RigError: no plant node there obeys commands, or the plant node refuses ``command``.
    """
    require_possible(command)
    hearing = TolerantBus(bus, SYSTEM_CLOCK)
    state, is_silent = _state(hearing)
    if state is None:
        raise RigError(
            f"bus {name}: silent; no nodes run there, or they have another bus (--bus)"
            if is_silent
            else f"bus {name}: no plant node says that it obeys commands; "
            "it must be started with --injectable"
        )
    if command.action == "STEP" and not state.paused:
        raise RigError(f"bus {name}: nothing is paused; inject pause comes before step")
    message = operator_frames.command_message(command, state.next_sequence)
    try:
        bus.send(message)
    except can.CanError as error:
        raise BusError(f"bus {name}: {one_line(error)}") from error
    end_s = time.monotonic() + WITHIN_S
    while time.monotonic() < end_s:
        after, _ = _state(hearing)
        if after is None:
            break
        if after.next_sequence != state.next_sequence:
            if after.last_checksum != message.data[0]:
                raise RigError(f"bus {name}: somebody else was quicker; try again")
            if after.refused != state.refused:
                raise RigError(f"bus {name}: refused, as no such thing can be done")
            return
    raise RigError(f"bus {name}: the plant node did not answer within {WITHIN_S:g} s")


def _state(bus: TolerantBus) -> tuple[operator_frames.State | None, bool]:
    """The next state of a plant node (None after a timeout), and whether the bus is silent."""
    frame_id, is_silent = operator_frames.identifiers().state, True
    end_s = time.monotonic() + WITHIN_S
    while (left_s := end_s - time.monotonic()) > 0.0:
        message = bus.recv(left_s)
        is_silent = is_silent and message is None
        if message is not None and message.arbitration_id == frame_id:
            said = operator_frames.read_state(message)
            if said is not None:
                return said, False
    return None, is_silent
