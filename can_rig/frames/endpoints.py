"""The two ends of a frame on the bus: record → protected frame, and back.

`Hearing` is the receiving end of further sensors, whose frames come with periods of their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from can import Message

from can_rig.frames.codec import SAMPLE_BITS, MessageCodec, Record
from can_rig.frames.protection import USABLE, Checker, Protector, Unprotected

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


class Transmitter:
    """The sending end of one frame: codec, then protection."""

    def __init__(self, codec: MessageCodec) -> None:
        self.codec: Final = codec
        self._protector = None if codec.data_id is None else Protector(codec.data_id)

    def frame(
        self,
        value: float,
        tick: int,
        mode: int = 0,
        fault_state: int = 0,
        verdict: int = 0,
    ) -> Message:
        """The next frame, ready to send; for the arguments see `MessageCodec.encode`."""
        codec = self.codec
        data = codec.encode(value, tick, mode, fault_state, verdict)
        if self._protector is not None:
            self._protector.protect(data)
        return Message(
            0.0, codec.frame_id, codec.extended, False, False, None, len(data), data, codec.fd
        )


class Receiver:
    """The receiving end of one frame: protection, then codec.

    Args:
        codec: the frame.
        max_delta_counter: see `Checker`.
    """

    def __init__(self, codec: MessageCodec, max_delta_counter: int = 1) -> None:
        self.codec: Final = codec
        length = codec.layout.length
        self.checker: Final[Checker] = (
            Unprotected(length)
            if codec.data_id is None
            else Checker(codec.data_id, max_delta_counter, length)
        )
        self._length = length
        self._has_tick = codec.layout.has_tick
        self._judged = False  # whether the checker judged a frame of this tick

    def accept(self, message: Message, tick: int | None = None) -> Record | None:
        """The content of a usable frame; None for a rejected frame, counted by reason.

        A frame without a tick belongs to ``tick``, or to tick 0 if ``tick`` is None.

        Call `end_tick` at the end of each tick. NOT_AVAILABLE gives a value of nan.

        Args:
            message: a received frame with the codec's identifier.
            tick: the current tick; a frame of another tick, modulo 65536, is rejected. None: accept
                any tick.
        """
        data = message.data
        if (
            message.is_extended_id != self.codec.extended
            or message.is_fd != self.codec.fd
            or message.is_remote_frame
            or message.is_error_frame
        ):
            return None  # another kind of frame with an equal identifier
        if len(data) == self._length:
            record = self.codec.decode(data)
            if not self._has_tick:
                record = record._replace(tick=(tick or 0) & 0xFFFF)
            if tick is None or record.tick == tick & 0xFFFF:
                self._judged = True
                return record if self.checker.check(data) in USABLE else None
        self.checker.reject(data)
        return None

    def end_tick(self) -> None:
        """Tell the checker about a tick without a judged frame."""
        if not self._judged:
            self.checker.no_new_data()
        self._judged = False

    @property
    def rejected(self) -> dict[str, int]:
        """Number of rejected frames by `CheckStatus` in lower case, without zeros."""
        counts = self.checker.counts
        return {s.name.lower(): n for s, n in counts.items() if n and s not in USABLE}
