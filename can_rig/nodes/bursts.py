"""All frames of a node's tick in one datagram of the local bus, by one compiled call each way.

A call packs and protects the node's frames, or checks and reads the other node's frames, and writes
the log lines. Every other bus carries the frames one by one. The local bus does the same for the
first tick, a damaged frame, a frame of a third node, and in a run with frame faults. The bytes on
the bus and in the log are equal.
"""

import time
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import numpy as np

from can_rig.buses.local.bus import BURST_MOST, MAX_BYTES, PLAIN_BYTES, LocalBus
from can_rig.frames.codec import COUNTERS, FRAME_BYTES, MessageCodec, Receiver
from can_rig.frames.frame_columns import (
    CRC,
    IDENTIFIER,
    VERDICT_BITS,
    constants,
    crc_of,
    frame_word,
)
from can_rig.nodes.bus_access import POLL_S, PersistentSender
from can_rig.nodes.recording import LINE_BYTES, CandumpLines, write_line
from firmware_model.compiled import compiled

_WORDS: Final = PLAIN_BYTES // 8
_TIME, _HEADER, _DATA = range(_WORDS)
"""Words of a frame on the local bus: time stamp; identifier, flags and DLC; data."""


class Bursts:
    """One node's access to the frames of a tick as bursts.

    Args:
        bus: joined for bursts.
        send: the same bus's sender.
        codecs: the frames that this node sends in a tick, at most three, in bus order.
        receivers: the receivers of the other node's frames, in bus order.
        lines: the log of this node; None: no log.
    """

    def __init__(
        self,
        bus: LocalBus,
        send: PersistentSender,
        codecs: Sequence[MessageCodec],
        receivers: Sequence[Receiver],
        lines: CandumpLines | None,
    ) -> None:
        self._bus, self._send, self._lines = bus, send, lines
        self._checkers = [receiver.checker for receiver in receivers]
        self._own = constants(codecs)
        self._counters = np.zeros(len(codecs), np.int64)  # of the next frames
        self._frames = np.zeros((len(codecs), _WORDS), np.int64)
        self._frames[:, _HEADER] = self._own[0][:, IDENTIFIER] | FRAME_BYTES << 40
        self._times = self._frames.view(np.float64)[:, _TIME]
        self._datagram = memoryview(self._frames.data).cast("B")
        self._others = constants([each.codec for each in receivers])
        self._expected = np.zeros(len(receivers), np.int64)  # counters of the next frames
        self._size = len(receivers) * PLAIN_BYTES
        self._buffer = np.zeros(max(MAX_BYTES // 8, BURST_MOST * _WORDS), np.int64)
        self._read = memoryview(self._buffer.data).cast("B")
        self._values = np.zeros(len(receivers))
        longest = max(len(codecs), len(receivers))
        self._text = np.zeros(longest * LINE_BYTES if lines else 0, np.uint8)
        self._characters = memoryview(self._text.data)
        self._ready = False  # whether the expected counters are those of the receivers
        self._usual = 0  # ticks since the receivers knew the counters
        warm_up()

    def send(
        self,
        tick: int,
        values: tuple[float, float, float],
        mode: int = 0,
        fault_state: int = 0,
        verdict: int = 0,
    ) -> None:
        """Send and log this node's frames of ``tick``; surplus values have no meaning."""
        lines = self._lines
        length = _pack(
            *self._own, self._counters, self._frames, self._text, *values, tick, mode, fault_state,
            verdict, 0 if lines is None else lines.time_us,
        )  # fmt: skip
        self.repeat()
        if lines is not None:
            lines.add(bytes(self._characters[:length]), len(self._counters))

    def repeat(self) -> None:
        """Send the same frames, without a log."""
        self._times.fill(time.time())
        self._send.insist(self._bus.send_burst, self._datagram)

    def receive(self, tick: int) -> list[float] | None:
        """The values of the other node's frames of ``tick``, nan for NOT_AVAILABLE.

        Returns:
            None for any other datagram and after a timeout; the bus's ``recv`` then has every
            frame, and the receivers know every counted frame.
        """
        if not self._ready and not self._follow():
            return None
        size = self._bus.recv_burst(self._read, POLL_S)
        if size == self._size:
            lines = self._lines
            length = _check(
                *self._others, self._expected, self._buffer, self._values, self._text, tick,
                0 if lines is None else lines.time_us,
            )  # fmt: skip
            if length >= 0:
                self._usual += 1
                if lines is not None:
                    lines.add(bytes(self._characters[:length]), len(self._expected))
                found: list[float] = self._values.tolist()
                return found
        if size:
            self._bus.unread(bytes(self._read[:size]))
        self.let_receivers_know()
        return None

    def let_receivers_know(self) -> None:
        """Count every frame of a burst in its receiver, too, whose counter is then the next."""
        for checker in self._checkers:
            checker.go_on(self._usual)
        self._ready, self._usual = False, 0

    def _follow(self) -> bool:
        """Take the counters from the receivers."""
        for at, checker in enumerate(self._checkers):
            counter = checker.expected
            if counter is None:
                return False
            self._expected[at] = counter
        self._ready = True
        return True


@cache
def warm_up() -> None:
    """Compile, or load from the cache, before the first tick and before a process is forked."""
    whole, scales = np.zeros((1, 7), np.int64), np.ones((1, 6))
    counters = np.zeros(1, np.int64)
    text, frames = np.zeros(LINE_BYTES, np.uint8), np.zeros((1, _WORDS), np.int64)
    _pack(whole, scales, counters, frames, text, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0)
    _check(whole, scales, counters, frames.ravel(), np.zeros(1), text, 0, 0)


@compiled
def _pack(
    codecs: Any,
    scales: Any,
    counters: Any,
    frames: Any,
    text: Any,
    value_1: float,
    value_2: float,
    value_3: float,
    tick: int,
    mode: int,
    fault_state: int,
    verdict: int,
    time_us: int,
) -> int:
    """Fill in the data of ``frames``, and their log lines; returns the length of the lines."""
    at = 0
    for row in range(len(codecs)):
        value = value_1 if row == 0 else value_2 if row == 1 else value_3
        data = frame_word(
            codecs, scales, row, value, tick, counters[row], mode, fault_state, verdict
        )
        frames[row, _DATA] = data
        counters[row] = (counters[row] + 1) % COUNTERS
        if len(text) > 0:
            at = write_line(text, at, time_us + row, codecs[row, IDENTIFIER], data, True)
    return at


@compiled
def _check(
    codecs: Any,
    scales: Any,
    counters: Any,
    words: Any,
    values: Any,
    text: Any,
    tick: int,
    time_us: int,
) -> int:
    """Read the values of a burst, and write its log lines; returns the length of the lines.

    Returns -1 and changes no counter where a frame is not the next frame of ``tick``.
    """
    at = 0
    for row in range(len(codecs)):
        header, data = words[row * _WORDS + _HEADER], words[row * _WORDS + _DATA]
        if header != codecs[row, IDENTIFIER] | FRAME_BYTES << 40:
            return -1
        if data >> 16 & 0xFFFF != tick & 0xFFFF or data >> 8 & 15 != counters[row]:
            return -1
        if data & 255 != crc_of(data, codecs[row, CRC]):
            return -1
        raw = data >> (32 + codecs[row, VERDICT_BITS])
        values[row] = np.nan
        if scales[row, 3] <= raw <= scales[row, 4]:
            values[row] = raw * scales[row, 0]
        if len(text) > 0:
            at = write_line(text, at, time_us + row, codecs[row, IDENTIFIER], data, False)
    for row in range(len(codecs)):
        counters[row] = (counters[row] + 1) % COUNTERS
    return at
