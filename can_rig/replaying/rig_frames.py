"""The rig's frames in a log, and the late or missing answers of a run in real time."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from e2e.p01 import e2e_p01_check

from can_rig.controllers.protocol import NodeController
from can_rig.frames.codec import COUNTERS, ROLES, WIRE_TICKS, MessageCodec, tick_at, ticks_ahead
from can_rig.frames.network import Network
from can_rig.logs.frames import ERROR, EXTENDED, FD, NS_PER_S, REMOTE, Frames
from can_rig.plant.actuators import Actuator
from can_rig.scenario.settings import Scenario

INPUTS: Final = 2
"""Number of the first roles, reference and feedback; the roles of the answer follow."""

SPEED_ROLE: Final = len(ROLES)
"""Role of the speed, which precedes both inputs in networks with a speed frame; the roles of
further sensors follow."""


def is_input(role: int) -> bool:
    """Whether the frame is an input of the controller, and not part of the answer."""
    return role < INPUTS or role >= SPEED_ROLE


def codecs_of(network: Network) -> dict[int, MessageCodec]:
    """The frames of ``network`` by role."""
    further = enumerate(network.witnesses, SPEED_ROLE + 1)
    return {**dict(enumerate(network.by_role)), **dict(further)}


class RigFrame(NamedTuple):
    """One frame of the network in a log."""

    role: int
    """An index of `codec.ROLES`, ``SPEED_ROLE``, or, beyond both, of a further sensor."""
    time_ns: int
    """Time stamp; see `Frames.time_ns`."""
    data: bytes
    tick: int
    """Tick on the wire, modulo 65536; 0 in a frame too short for a tick."""
    counter: int
    intact: bool
    """Whether length, CRC and data identifier are right."""


def rig_frames(chunks: Iterable[Frames], network: Network) -> Iterator[RigFrame]:
    """The frames of ``network`` in a log, in order.

    Frames without a tick are counted: a reference or a feedback belongs to the tick after the last
    frame of the same message, an answer to the tick of the last feedback.
    """
    codecs = codecs_of(network)
    roles = {codec.frame_id: role for role, codec in codecs.items()}
    kinds = {role: codec.extended * EXTENDED | codec.fd * FD for role, codec in codecs.items()}
    identifiers = np.array(sorted(roles), dtype=np.uint32)
    counted = [-1] * INPUTS
    for chunk in chunks:
        frames = chunk[np.isin(chunk.arbitration_id, identifiers) & ~chunk.has(REMOTE | ERROR)]
        payloads, width = frames.data.tobytes(), frames.data.shape[1]
        columns = (frames.arbitration_id, frames.flags, frames.length, frames.time_ns)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for at, (identifier, flags, length, time_ns) in enumerate(rows):
            role = roles[identifier]
            if flags & (EXTENDED | FD) != kinds[role]:
                continue
            codec, data = codecs[role], payloads[at * width : at * width + length]
            tick = codec.layout.tick(data)
            if tick is None:
                if role < INPUTS:
                    counted[role] += 1
                tick = counted[role if role < INPUTS else INPUTS - 1] % WIRE_TICKS
            counter = tick % COUNTERS  # without a counter: no frame lost or repeated
            if codec.protected and length > 1:
                counter = data[1] & 0x0F
            yield RigFrame(role, time_ns, data, tick, counter, _intact(codec, data))


def _intact(codec: MessageCodec, data: bytes) -> bool:
    right = len(data) == codec.layout.length
    return right and (codec.data_id is None or e2e_p01_check(bytearray(data), codec.data_id))


COMMANDS = 2
"""Commands of a tick."""


@dataclass
class Recorded:
    """The missing and late answers of a controller in a real-time log, tick by tick.

    The commands of a tick are missing in the log, or follow the reference of the tick from whose
    deadline on the commands should have acted. The recorded controller told F1 the values that the
    actuators applied meanwhile (`nodes.realtime.controller_node`); a replay must do the same.
    Outages after which the controller took over anew (`law.supervision.takeover`) are not replayed.
    """

    scenario: Scenario
    first_tick: int = 0
    answered: dict[int, int] = field(default_factory=dict)
    """By tick, the number of commands in the log."""
    late: set[int] = field(default_factory=set)
    """Ticks with commands after the deadline."""

    def __post_init__(self) -> None:
        hold_ticks = round(self.scenario.actuator.hold_s / self.scenario.tick_s)
        self._actuators = Actuator(hold_ticks), Actuator(hold_ticks)
        self._sent: dict[int, tuple[float, float]] = {}

    def begin(self, tick: int, controller: NodeController) -> bool:
        """Tell the controller the acting commands from ``tick`` on.

        Args:
            tick: the tick on the wire, or counted from the first contact on.
            controller: before its step.

        Returns:
            Whether the recorded controller answered the sample of ``tick``.
        """
        tick = self._counted(tick)
        acting = tick - self.scenario.latency_ticks
        sent = self._sent.pop(acting, None)
        if sent is not None and acting not in self.late:
            for actuator, command in zip(self._actuators, sent, strict=True):
                actuator.hear(command)
        elif acting >= self.first_tick:
            controller.act(*(actuator.hear(None) for actuator in self._actuators))
        return self.answered.get(tick, 0) == COMMANDS

    def send(self, tick: int, commands: tuple[float, float]) -> None:
        """Note the commands of an answered tick."""
        if self.answered.get(self._counted(tick), 0) == COMMANDS:
            self._sent[self._counted(tick)] = commands

    def _counted(self, tick: int) -> int:
        return tick + (self.first_tick - self.first_tick % WIRE_TICKS)


def recorded(chunks: Iterable[Frames], network: Network, scenario: Scenario) -> Recorded:
    """Read the answers of a run in real time."""
    found: Recorded | None = None
    newest = 0  # tick of a reference
    for frame in rig_frames(chunks, network):
        if not frame.intact:
            continue
        if found is None:
            newest = tick_at(frame.tick, frame.time_ns / NS_PER_S, scenario.tick_s)
            found = Recorded(scenario, newest)
        tick = newest + ticks_ahead(frame.tick, newest)
        if is_input(frame.role):
            newest = max(newest, tick)
        elif frame.role < INPUTS + COMMANDS:
            found.answered[tick] = found.answered.get(tick, 0) + 1
            if newest >= tick + scenario.latency_ticks:
                found.late.add(tick)
    return found or Recorded(scenario)
