"""What today's controller answers beside what the log has, signal by signal, as on the wire."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from can_rig.frames.codec import MessageCodec, Unpacked
from can_rig.frames.network import Network
from can_rig.logs.frames import NS_PER_S
from can_rig.replay.gaps import Row
from can_rig.replay.rig_frames import INPUTS, SPEED_ROLE

ANSWERS: Final = 3
"""Frames of a controller's answer: both commands and the status."""


@dataclass
class Place:
    """One tick in which a signal differs."""

    tick: int
    time_s: float
    """Time stamp in the log."""
    logged: float | str
    """What the log has: in the signal's unit, a word of its value table, or "not available"."""
    replayed: float | str
    """What the replay has."""


@dataclass
class SignalComparison:
    """One signal over all ticks; a tick without a usable frame in the log is not compared."""

    message: str
    signal: str
    unit: str
    compared: int = 0
    """Ticks."""
    different: int = 0
    first: Place | None = None
    largest: float = 0.0
    """Largest difference [unit]; of a signal with a value table, nan if there is any; of one that
    is not available on one side, nan."""
    largest_at: Place | None = None

    def as_dict(self) -> dict[str, Any]:
        """Every figure by its name; nan as None."""
        values = asdict(self)
        values["largest"] = None if math.isnan(self.largest) else self.largest
        return values


VALUE, MODE, FAULT_STATE, VERDICT = 0, 2, 3, 4
"""Where a frame that is unpacked says what."""


@dataclass
class _Signal:
    """Where a signal lies in its frame, and the comparison of it."""

    result: SignalComparison
    codec: MessageCodec
    at: int = VALUE
    words: Mapping[int, str] = field(default_factory=dict)

    def raw(self, said: Unpacked) -> float:
        return said[self.at]

    def shown(self, raw: float) -> float | str:
        if self.at != VALUE:
            return self.words.get(int(raw), str(raw))
        value = self.codec.from_raw(raw)
        return "not available" if math.isnan(value) else value

    def compare(self, tick: int, time_ns: int, logged: float, replayed: float) -> None:
        result = self.result
        result.compared += 1
        if logged == replayed:
            return
        result.different += 1
        place = Place(tick, time_ns / NS_PER_S, self.shown(logged), self.shown(replayed))
        if result.first is None:
            result.first = place
        size = math.nan
        if self.at == VALUE:  # nan where one is not available
            steps = abs(logged - replayed) * (self.codec.lsb or 1.0)
            size = steps + 0.0 * (self.codec.from_raw(logged) + self.codec.from_raw(replayed))
        # A difference that has a size says more than one that has none.
        if result.largest_at is None or size > result.largest or math.isnan(result.largest):
            result.largest, result.largest_at = size, place


class Comparison:
    """Compares tick by tick.

    Args:
        network: the frames.
    """

    def __init__(self, network: Network) -> None:
        codecs = tuple(network)[INPUTS:]
        self._says_speed = network.speed is not None
        self._signals = [_signals(codec) for codec in codecs]
        self.ticks = 0
        """All that the controller answered."""
        self.compared = 0
        """Ticks of which everything could be compared."""
        self.without_input = 0
        """Ticks not compared, because the log lacks the reference or the feedback."""
        self.without_answer = dict.fromkeys((codec.name for codec in codecs), 0)
        """By message, ticks not compared, because the log has no usable frame of it."""
        self.same_bytes = 0
        """Frames that are the same as in the log in every byte, counter and CRC included."""
        self.other_counter = 0
        """Frames that say the same with another counter."""
        self._names = [codec.name for codec in codecs]
        self._layouts = [codec.layout for codec in codecs]

    @property
    def signals(self) -> list[SignalComparison]:
        """The result, signal by signal."""
        return [signal.result for signals in self._signals for signal in signals]

    @property
    def identical(self) -> bool:
        """Whether nothing that could be compared differs."""
        return not any(signal.different for signal in self.signals)

    @property
    def first_different_tick(self) -> int | None:
        """The first tick in which any signal differs."""
        return min((s.first.tick for s in self.signals if s.first is not None), default=None)

    def tick(self, tick: int, row: Row, answer: Sequence[bytes]) -> None:
        """Compare one tick: what the log has of it, and the frames that the replay sent."""
        self.ticks += 1
        if None in row.seen[:INPUTS] or (self._says_speed and row.seen[SPEED_ROLE] is None):
            self.without_input += 1
            return
        whole = True
        for at, replayed in enumerate(answer):
            logged = row.seen[INPUTS + at]
            if logged is None:
                self.without_answer[self._names[at]] += 1
                whole = False
                continue
            if logged == replayed:
                self.same_bytes += 1
                for signal in self._signals[at]:
                    signal.result.compared += 1
                continue
            layout = self._layouts[at]
            one, other = layout.unpack(logged), layout.unpack(replayed)
            pairs = [(signal.raw(one), signal.raw(other)) for signal in self._signals[at]]
            self.other_counter += all(a == b for a, b in pairs)
            for signal, (a, b) in zip(self._signals[at], pairs, strict=True):
                signal.compare(tick, row.time_ns, a, b)
        self.compared += whole


def _signals(codec: MessageCodec) -> list[_Signal]:
    def signal(name: str, unit: str, **where: Any) -> _Signal:
        return _Signal(SignalComparison(codec.name, name, unit), codec, **where)

    found = [signal(codec.signal_name, codec.unit)]
    if codec.modes:
        found.append(signal("Mode", "", at=MODE, words=codec.modes))
        found.append(signal("FaultState", "", at=FAULT_STATE, words=codec.fault_states))
    if codec.verdicts:
        found.append(signal("Verdict", "", at=VERDICT, words=codec.verdicts))
    return found
