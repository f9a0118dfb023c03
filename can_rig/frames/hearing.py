"""The receiving end of further sensors: frames that come with periods of their own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from can import Message

from can_rig.frames.codec import SAMPLE_BITS, MessageCodec
from can_rig.frames.endpoints import Receiver

AGE: Final = "_age_ticks"
"""Ending of the name of a sample's age."""

NOTHING: Final[Mapping[str, float]] = {}


class Hearing:
    """Receives the frames of the further sensors, tick by tick.

    Args:
        codecs: their frames.
        timings: period, phase and delay of each, ticks.
        names: of each, for what is heard.
    """

    def __init__(
        self,
        codecs: Sequence[MessageCodec],
        timings: Sequence[tuple[int, int, int]],
        names: Sequence[str],
    ) -> None:
        self.receivers: Final = tuple(Receiver(codec) for codec in codecs)
        self._timings, self._names = timings, names
        self._by_id = {codec.frame_id: at for at, codec in enumerate(codecs)}
        self._now = nothing_heard(names)

    def concerns(self, message: Message) -> bool:
        """Whether ``message`` has the identifier of a further sensor."""
        return message.arbitration_id in self._by_id

    def take(self, message: Message, tick: int | None) -> None:
        """Take in a frame of ``tick``; None: of any. A frame marked invalid has no value."""
        at = self._by_id[message.arbitration_id]
        record = self.receivers[at].accept(message, tick)
        if record is None:
            return
        name = self._names[at]
        self._now[name] = record.value if record.mode else math.nan
        self._now[name + AGE] = (record.tick - record.verdict) % (1 << SAMPLE_BITS)

    def end_tick(self, tick: int) -> Mapping[str, float]:
        """What ``tick`` has brought: value and age of the sample, not a number where none came."""
        if not self.receivers:
            return NOTHING
        for receiver, (period, phase, _) in zip(self.receivers, self._timings, strict=True):
            if tick >= phase and (tick - phase) % period == 0:
                receiver.end_tick()
        found, self._now = self._now, nothing_heard(self._names)
        return found


def nothing_heard(names: Sequence[str]) -> dict[str, float]:
    """Value and age of the samples of sensors that sent nothing."""
    return {name + end: math.nan for name in names for end in ("", AGE)}
