"""What scheduled faults make of a frame on its way: lost, damaged, repeated, late, forged."""

from __future__ import annotations

import random
from collections import deque
from copy import copy
from typing import Final, Protocol

from can import Message

from can_rig.frames.codec import MessageCodec
from can_rig.frames.endpoints import Transmitter
from can_rig.frames.network import Network
from can_rig.scenario.settings import Scenario
from can_rig.scenario.tables.fault import PLACES, FaultSettings

SENSOR_PLACE: Final = 2
"""The number of the frame of D*, behind those of both commands."""


class FrameFault(Protocol):
    """One fault; it is asked at every tick."""

    def pass_on(self, frames: list[Message], tick: int) -> list[Message]:
        """The frames that go on, of those of ``tick`` that have come so far."""


class Missing:
    """No frame goes on."""

    def __init__(self, ticks: range) -> None:
        self._ticks = ticks

    def pass_on(self, frames: list[Message], tick: int) -> list[Message]:
        """See ``FrameFault``."""
        return [] if tick in self._ticks else frames


class Corrupted:
    """One byte of each frame is changed after protection.

    That is a burst of at most 8 bits, which a CRC-8 always detects, so a corrupted frame is never
    taken for a good one by luck. Faults that overlap share one of these, so that no frame is
    changed twice.
    """

    def __init__(self, seed: int) -> None:
        self.ticks: Final[list[range]] = []
        self._random = random.Random(seed)

    def pass_on(self, frames: list[Message], tick: int) -> list[Message]:
        """See ``FrameFault``."""
        if not any(tick in ticks for ticks in self.ticks):
            return frames
        return [self._damaged(frame) for frame in frames]

    def _damaged(self, frame: Message) -> Message:
        damaged, data = copy(frame), bytearray(frame.data)
        data[self._random.randrange(len(data))] ^= self._random.randrange(1, 256)
        damaged.data = data
        return damaged


class Repeated:
    """The last frame before the fault goes on again and again; none where there was none."""

    def __init__(self, ticks: range) -> None:
        self._ticks = ticks
        self._last: list[Message] = []

    def pass_on(self, frames: list[Message], tick: int) -> list[Message]:
        """See ``FrameFault``."""
        if tick in self._ticks:
            return [copy(frame) for frame in self._last]
        self._last = frames[-1:]
        return frames


class Late:
    """Each frame goes on so many ticks later, before that of the tick."""

    def __init__(self, ticks: range, late_ticks: int) -> None:
        self._ticks = ticks
        self._late_ticks = late_ticks
        self._waiting: deque[tuple[int, list[Message]]] = deque()

    def pass_on(self, frames: list[Message], tick: int) -> list[Message]:
        """See ``FrameFault``."""
        if tick in self._ticks:
            self._waiting.append((tick + self._late_ticks, frames))
            frames = []
        due: list[Message] = []
        while self._waiting and self._waiting[0][0] <= tick:
            due += self._waiting.popleft()[1]
        return due + frames


class Forged:
    """An intruder's frame with a value of its own comes first, with the right CRC and counter."""

    def __init__(self, ticks: range, codec: MessageCodec, value: float) -> None:
        self._ticks = ticks
        self._intruder = Transmitter(codec)
        self._value = value

    def pass_on(self, frames: list[Message], tick: int) -> list[Message]:
        """See ``FrameFault``."""
        forged = self._intruder.frame(self._value, tick)  # at every tick, so that it counts along
        return [forged, *frames] if tick in self._ticks else frames


class FrameFaults:
    """The faults of a scenario that concern its commands and the frame of D*.

    A place is 0 or 1 for a command, ``SENSOR_PLACE`` for D*. Faults that overlap act one after the
    other, in the order of the scenario.
    """

    def __init__(self, scenario: Scenario, network: Network) -> None:
        codecs = (network.command_1, network.command_2, network.feedback)
        self._faults: tuple[list[FrameFault], ...] = tuple([] for _ in codecs)
        self.ticks: Final[tuple[list[range], ...]] = tuple([] for _ in codecs)
        """Of each place, from when to when a fault may change something."""
        damage = tuple(Corrupted(scenario.seed) for _ in codecs)
        run = range(scenario.ticks)
        for fault in scenario.faults:
            if not fault.acts_on_frames:
                continue
            place, ticks = PLACES.index(fault.place), fault.ticks(scenario.tick_ns, run)
            late_ticks = fault.late_ticks if fault.kind == "frames-late" else 0
            self.ticks[place].append(range(ticks.start, ticks.stop + late_ticks))
            if fault.kind == "frames-corrupted":
                damage[place].ticks.append(ticks)
                if damage[place] not in self._faults[place]:
                    self._faults[place].append(damage[place])
            else:
                self._faults[place].append(_fault(fault, ticks, codecs[place]))

    def on_the_wire(
        self, frame: Message, place: int, tick: int, otherwise: Message | None = None
    ) -> list[Message]:
        """What goes on the bus where the node of ``place`` sends ``frame`` of ``tick``.

        Where that is not among it, ``otherwise`` comes last: the frame of D* starts a tick of the
        controller, which a lockstep run cannot go on without.
        """
        frames = [frame]
        for fault in self._faults[place]:
            frames = fault.pass_on(frames, tick)
        if otherwise is not None and not any(each is frame for each in frames):
            frames.append(otherwise)
        return frames

    def concerns(self, place: int) -> bool:
        """Whether frames of ``place`` are changed at some time."""
        return bool(self._faults[place])


def _fault(fault: FaultSettings, ticks: range, codec: MessageCodec) -> FrameFault:
    if fault.kind == "frames-repeated":
        return Repeated(ticks)
    if fault.kind == "frames-late":
        return Late(ticks, fault.late_ticks)
    if fault.kind == "frames-forged":
        assert fault.value is not None
        return Forged(ticks, codec, fault.value)
    return Missing(ticks)
