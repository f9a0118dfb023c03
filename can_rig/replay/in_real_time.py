"""What a run in real time left unanswered, or answered too late, so that a replay does the same.

The log says it: the commands of a tick are missing, or come after the reference of the tick from
whose deadline on they should have acted. The recorded controller knew it too, and told F1 what the
actuators did without them (`nodes.realtime.controller_node`). A replay that takes every sample for
answered in time would differ from the first late command on.

Outages after which the controller took over anew (`nodes.realtime.restart`) are not replayed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from can_rig.frames.codec import WIRE_TICKS, tick_at, ticks_ahead
from can_rig.frames.network import Network
from can_rig.logs.frames import NS_PER_S, Frames
from can_rig.plant.actuators import Actuator
from can_rig.replay.rig_frames import INPUTS, is_input, rig_frames
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware

COMMANDS = 2
"""Frames of a tick that act."""


@dataclass
class Recorded:
    """What became of the answers of a recorded controller, tick by tick."""

    scenario: Scenario
    first_tick: int = 0
    answered: dict[int, int] = field(default_factory=dict)
    """By tick, how many of its commands are in the log."""
    late: set[int] = field(default_factory=set)
    """Ticks whose commands came when they should have acted already."""

    def __post_init__(self) -> None:
        hold_ticks = round(self.scenario.actuator.hold_s / self.scenario.tick_s)
        self._actuators = Actuator(hold_ticks), Actuator(hold_ticks)
        self._sent: dict[int, tuple[float, float]] = {}

    def begin(self, tick: int, firmware: Firmware) -> bool:
        """Tell the firmware what acts from ``tick`` on; whether its sample was answered.

        Args:
            tick: as the wire has it, or as it is counted from the first contact on.
            firmware: before its step.
        """
        tick = self._counted(tick)
        acting = tick - self.scenario.latency_ticks
        sent = self._sent.pop(acting, None)
        if sent is not None and acting not in self.late:
            for actuator, command in zip(self._actuators, sent, strict=True):
                actuator.hear(command)
        elif acting >= self.first_tick:
            firmware.act(*(actuator.hear(None) for actuator in self._actuators))
        return self.answered.get(tick, 0) == COMMANDS

    def send(self, tick: int, commands: tuple[float, float]) -> None:
        """Note the commands of a tick that was answered."""
        if self.answered.get(self._counted(tick), 0) == COMMANDS:
            self._sent[self._counted(tick)] = commands

    def _counted(self, tick: int) -> int:
        return tick + (self.first_tick - self.first_tick % WIRE_TICKS)


def recorded(chunks: Iterable[Frames], network: Network, scenario: Scenario) -> Recorded:
    """Look through the log of a run in real time."""
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
