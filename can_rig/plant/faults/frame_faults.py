"""The effects of scheduled faults on a frame in transit, and the receivers' verdicts on a run.

A frame is lost, damaged, repeated, late or forged. For the fate of a run's frames, values play no
part; sending and timing decide. ``delivery`` asks the receivers themselves, because their alive
counters also reject frames right after an outage.
"""

import math
import random
from collections import deque
from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Protocol

import numpy as np
from can import Message
from numpy.typing import NDArray

from can_rig.frames.codec import COUNTERS, MessageCodec, Receiver, Transmitter
from can_rig.frames.network import Network
from can_rig.scenario.fault_settings import FaultSettings, Outage
from can_rig.scenario.sensor_settings import SAMPLE_TICKS
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import BoolArray

SENSOR_PLACE: Final = 2
"""Place number of the D* frame, after both commands."""
STATUS: Final = 2
"""Column of the status frame, which no fault changes, after both commands."""


class FrameFault(Protocol):
    """The effect on one sender's frames, called at every tick."""

    def pass_on(self, frames: list[Message], tick: int, there: bool) -> list[Message]:
        """Return the frames that continue, given the frames of ``tick`` so far.

        ``there`` says whether the fault acts at this tick.
        """


class Missing:
    """No frame continues."""

    def pass_on(self, frames: list[Message], tick: int, there: bool) -> list[Message]:
        """See ``FrameFault``."""
        return [] if there else frames


class Corrupted:
    """Protected frames with one byte changed.

    The change is a burst of at most 8 bits. A CRC-8 detects every such burst, so luck never makes a
    corrupted frame valid.
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def pass_on(self, frames: list[Message], tick: int, there: bool) -> list[Message]:
        """See ``FrameFault``."""
        return [self._damaged(frame) for frame in frames] if there else frames

    def _damaged(self, frame: Message) -> Message:
        damaged, data = copy(frame), bytearray(frame.data)
        data[self._random.randrange(len(data))] ^= self._random.randrange(1, 256)
        damaged.data = data
        return damaged


class Repeated:
    """The last frame before the fault repeats; without an earlier frame, no frame repeats.

    ``last`` belongs to the tick before the first call.
    """

    def __init__(self, last: list[Message]) -> None:
        self._last = last

    def pass_on(self, frames: list[Message], tick: int, there: bool) -> list[Message]:
        """See ``FrameFault``."""
        if there:
            return [copy(frame) for frame in self._last]
        self._last = frames[-1:]
        return frames


class Late:
    """Each frame continues this many ticks later, before the frame of the current tick."""

    def __init__(self, late_ticks: int) -> None:
        self._late_ticks = late_ticks
        self._waiting: deque[tuple[int, list[Message]]] = deque()

    def pass_on(self, frames: list[Message], tick: int, there: bool) -> list[Message]:
        """See ``FrameFault``."""
        if there:
            self._waiting.append((tick + self._late_ticks, frames))
            frames = []
        due: list[Message] = []
        while self._waiting and self._waiting[0][0] <= tick:
            due += self._waiting.popleft()[1]
        return due + frames


class Forged:
    """An intruder's frame with a chosen value, a right CRC and a right counter comes first.

    ``before`` counts the frames sent before the first call.
    """

    def __init__(self, codec: MessageCodec, value: float, before: int) -> None:
        self._intruder = Transmitter(codec)
        self._value = value
        for tick in range(before % COUNTERS):
            self._intruder.frame(value, tick)

    def pass_on(self, frames: list[Message], tick: int, there: bool) -> list[Message]:
        """See ``FrameFault``."""
        # at every frame of the sender, to advance the counter; of a further sensor it is valid
        forged = self._intruder.frame(self._value, tick, 1, 0, tick % SAMPLE_TICKS)
        return [forged, *frames] if there else frames


class Scheduled(NamedTuple):
    """A fault's effect, and its active ticks."""

    settings: FaultSettings
    """The effect of an endless fault."""
    fault: FrameFault
    ticks: list[range]

    def at(self, tick: int) -> bool:
        """Whether the fault acts at ``tick``."""
        return any(tick in ticks for ticks in self.ticks)


class FrameFaults:
    """The faults of a scenario's frames.

    A place is 0 or 1 for a command, ``SENSOR_PLACE`` for D*, then come the further sensors; see
    ``Scenario.places``. Overlapping faults act in the scenario's order. All faults that corrupt a
    place's frames act as one fault, so each frame changes at most once.

    Args:
        scenario: the scenario with the faults.
        network: its frames.
        changing: whether the faults may change during the run.
    """

    def __init__(self, scenario: Scenario, network: Network, changing: bool = False) -> None:
        self._codecs, self._senders = network.can_fail, network.senders
        self._changing = changing
        self._scenario = scenario
        self.restart()

    def restart(self) -> None:
        """Forget every frame so far, as the sender does that begins again."""
        self._damage = tuple(Corrupted(self._scenario.seed) for _ in self._codecs)
        self._faults: tuple[list[Scheduled], ...] = tuple([] for _ in self._codecs)
        self._sent = [0] * len(self._codecs)  # frames of each place so far
        self._last: list[list[Message]] = [[] for _ in self._codecs]  # continued frames
        self.change(self._scenario)

    def change(self, scenario: Scenario) -> None:
        """Take the faults of ``scenario`` from the next frame on.

        A fault from before the change, perhaps with other times, keeps its memory.
        """
        self._scenario = scenario
        before, self._faults = self._faults, tuple([] for _ in self._codecs)
        self.ticks: tuple[list[range], ...] = tuple([] for _ in self._codecs)
        """For each place, the tick ranges with possible changes."""
        for settings in scenario.faults:
            if not settings.acts_on_frames:
                continue
            named = scenario.places.index(settings.place)
            place = self._senders[named]
            ticks = settings.ticks(scenario.tick_ns, range(scenario.ticks))
            late_ticks = settings.late_ticks if settings.kind == "frames-late" else 0
            self.ticks[place].append(range(ticks.start, ticks.stop + late_ticks))
            always, faults = replace(settings, for_s=None), self._faults[place]
            damaging = [each for each in faults if each.fault is self._damage[place]]
            if damaging and settings.kind == "frames-corrupted":
                damaging[0].ticks.append(ticks)
                continue
            known = [each for each in before[place] if each.settings == always]
            fault = known[0].fault if known else self._new(always, place, named)
            for each in known[:1]:
                before[place].remove(each)
            faults.append(Scheduled(always, fault, [ticks]))

    def on_the_wire(
        self, frame: Message | None, place: int, tick: int, otherwise: Message | None = None
    ) -> list[Message]:
        """The frames on the bus when the node of ``place`` sends ``frame`` of ``tick``.

        None is a tick between two frames of a further sensor, in which late frames alone come.

        Where ``frame`` itself is absent, ``otherwise`` comes last: the D* frame starts a controller
        tick, and a lockstep run needs every start.
        """
        if frame is None:
            late = (each.fault for each in self._faults[place] if isinstance(each.fault, Late))
            return [message for fault in late for message in fault.pass_on([], tick, False)]
        frames = [frame]
        for each in self._faults[place]:
            frames = each.fault.pass_on(frames, tick, each.at(tick))
        self._sent[place] += 1
        self._last[place] = frames[-1:]
        if otherwise is not None and not any(each is frame for each in frames):
            frames.append(otherwise)
        return frames

    def concerns(self, place: int) -> bool:
        """Whether a fault changes, or may change, frames of ``place``."""
        return self._changing or bool(self._faults[place])

    def _new(self, settings: FaultSettings, place: int, named: int) -> FrameFault:
        if settings.kind == "frames-corrupted":
            return self._damage[place]
        if settings.kind == "frames-repeated":
            return Repeated(self._last[place])
        if settings.kind == "frames-late":
            return Late(settings.late_ticks)
        if settings.kind == "frames-forged":
            assert settings.value is not None
            return Forged(self._codecs[named], settings.value, self._sent[place])
        return Missing()


# --- the fate of a run's frames ------------------------------------------------------------------

SETTLED: Final = 20
"""Ticks until a receiver with uninterrupted frames again uses every frame."""


@dataclass(frozen=True)
class Delivery:
    """The fate of the frames that can fail.

    Attributes:
        sent: (ticks, 2), whether a command frame of a tick is on the bus.
        used: (ticks, 2), whether the actuator uses the command.
        status: (ticks,), whether the plant node uses the status frame.
        damage: (n, 4), a row for each damaged command frame: tick, channel, byte, exclusive or of
            the byte.
        replaced: by tick and place (0 or 1: command, 2: D*), the used value in place of the sent
            value; nan: no value.
        rejected: by name, the number of the controller's frames rejected for each reason.
    """

    sent: BoolArray
    used: BoolArray
    status: BoolArray
    damage: NDArray[np.int64]
    replaced: dict[tuple[int, int], float]
    rejected: dict[str, dict[str, int]]


def delivery(scenario: Scenario, network: Network, ticks: int | None = None) -> Delivery:
    """The fate of the frames of the first ``ticks`` ticks; None: the whole run."""
    ticks = scenario.ticks if ticks is None else ticks
    sent, used = np.ones((2, ticks, 3), dtype=np.bool_)
    damage: list[tuple[int, int, int, int]] = []
    replaced: dict[tuple[int, int], float] = {}
    rejected: dict[str, dict[str, int]] = {}
    faults, outages = FrameFaults(scenario, network), scenario.outages
    for place, codec in enumerate((network.command_1, network.command_2, network.status)):
        faulty = place < STATUS
        transmitter, receiver = Transmitter(codec), Receiver(codec)
        for tick in _watched(faults.ticks[place] if faulty else [], outages, ticks):
            if any(tick == outage.stop for outage in outages):
                transmitter = Transmitter(codec)
                faults.restart()
            if any(tick in outage for outage in outages):
                sent[tick, place] = used[tick, place] = False
                receiver.end_tick()
                continue
            own = transmitter.frame(math.nan, tick)
            frames = faults.on_the_wire(own, place, tick) if faulty else [own]
            sent[tick, place] = bool(frames)
            damage += [(tick, place, *changed) for changed in _changes(own.data, frames)]
            records = [receiver.accept(frame, tick) for frame in frames]
            used[tick, place] = any(record is not None for record in records)
            for record in records:
                # the rig's own frames carry no data here
                if record is not None and math.isfinite(record.value):
                    replaced[tick, place] = record.value
            receiver.end_tick()
        rejected[codec.name] = receiver.rejected
    replaced |= _feedback(scenario, FrameFaults(scenario, network), network.feedback, ticks)
    return Delivery(
        sent[:, :STATUS].copy(),
        used[:, :STATUS].copy(),
        used[:, STATUS].copy(),
        np.array(damage, dtype=np.int64).reshape(len(damage), 4),
        replaced,
        rejected,
    )


def _feedback(
    scenario: Scenario, faults: FrameFaults, codec: MessageCodec, ticks: int
) -> dict[tuple[int, int], float]:
    """The controller's values in place of D*: the first usable frame of a tick counts."""
    replaced: dict[tuple[int, int], float] = {}
    transmitter, nothing, receiver = Transmitter(codec), Transmitter(codec), Receiver(codec)
    for tick in _watched(faults.ticks[SENSOR_PLACE], (), ticks):
        if any(tick == outage.stop for outage in scenario.outages):
            receiver = Receiver(codec)
        own, none = transmitter.frame(0.0, tick), nothing.frame(math.nan, tick)
        for frame in faults.on_the_wire(own, SENSOR_PLACE, tick, none):
            record = receiver.accept(frame, tick)
            if record is not None:
                if frame is not own:
                    replaced[tick, SENSOR_PLACE] = record.value
                break
        receiver.end_tick()
    return replaced


def _watched(changes: Iterable[range], outages: Iterable[Outage], ticks: int) -> range:
    """The ticks that need a look at every frame."""
    spans: list[range | Outage] = [*(span for span in changes if span), *outages]
    ends = [(max(span.start - 1, 0), span.stop) for span in spans]
    if not ends:
        return range(0)
    # One tick earlier the receiver has heard one frame; more earlier frames change nothing but the
    # counter, which a restart compares with that of its first frame.
    first = min(begin for begin, _ in ends)
    first -= first % COUNTERS
    return range(first, min(max(end for _, end in ends) + SETTLED, ticks))


def _changes(own: bytearray, frames: list[Message]) -> Iterator[tuple[int, int]]:
    """Each changed byte of the sent frame, with its exclusive or."""
    for frame in frames[:1]:
        pairs = zip(own, frame.data, strict=True)
        yield from ((at, a ^ b) for at, (a, b) in enumerate(pairs) if a != b)
