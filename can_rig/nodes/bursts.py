"""All frames of a node's tick in one datagram of the local bus, by one compiled call each way.

A call packs and protects the frames that the node sends, or checks and reads the frames of the
other node, and writes their log lines. Every other bus carries the same frames one by one; so does
the local bus where a tick is not the usual one: the first frames, a damaged frame, a frame of a
third node, a frame fault. The bytes on the bus and in the log are the same.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import numpy as np

from can_rig.buses.local.bus import BURST_MOST, MAX_BYTES, PLAIN_BYTES, LocalBus
from can_rig.frames.codec import MessageCodec, RigLayout
from can_rig.frames.endpoints import Receiver
from can_rig.frames.frame_columns import CRC_TABLES, crc_of_id, raw_value
from can_rig.frames.protection import COUNTERS, FRAME_BYTES
from can_rig.nodes.bus_access import POLL_S, PersistentSender
from can_rig.nodes.recording import LINE_BYTES, CandumpLines, write_line
from firmware_model.compiled import compiled

_WORDS: Final = PLAIN_BYTES // 8
_TIME, _HEADER, _DATA = range(_WORDS)
"""Words of a frame on the local bus: time stamp; identifier, flags and DLC; data."""

_IDENTIFIER, _CRC, _COUNTER, _MODE_SHIFT, _FAULT_STATE_SHIFT, _VERDICT_BITS = range(6)
"""Columns of the whole numbers of a codec; the counter is that of the next frame."""

_NO_MODE: Final = -1


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
        self._own, self._scales = _constants(codecs)
        self._frames = np.zeros((len(codecs), _WORDS), np.int64)
        self._frames[:, _HEADER] = self._own[:, _IDENTIFIER] | FRAME_BYTES << 40
        self._times = self._frames.view(np.float64)[:, _TIME]
        self._datagram = memoryview(self._frames.data).cast("B")
        self._others, self._other_scales = _constants([each.codec for each in receivers])
        self._size = len(receivers) * PLAIN_BYTES
        self._buffer = np.zeros(max(MAX_BYTES // 8, BURST_MOST * _WORDS), np.int64)
        self._read = memoryview(self._buffer.data).cast("B")
        self._values = np.zeros(len(receivers))
        longest = max(len(codecs), len(receivers))
        self._text = np.zeros(longest * LINE_BYTES if lines else 0, np.uint8)
        self._characters = memoryview(self._text.data)
        self._ready = False  # whether the counters of _others are those of the receivers
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
            self._own, self._scales, self._frames, self._text, *values, tick, mode, fault_state,
            verdict, 0 if lines is None else lines.time_us,
        )  # fmt: skip
        self.repeat()
        if lines is not None:
            lines.add(bytes(self._characters[:length]), len(self._own))

    def repeat(self) -> None:
        """Send the same frames, without a log."""
        self._times.fill(time.time())
        self._send.burst(self._bus.send_burst, self._datagram)

    def receive(self, tick: int) -> list[float] | None:
        """The values of the other node's frames of ``tick``, nan for NOT_AVAILABLE.

        Returns:
            None, if anything else has come, or nothing in time; the bus's ``recv`` then has every
            frame, and the receivers are up to date.
        """
        if not self._ready and not self._follow():
            return None
        size = self._bus.recv_burst(self._read, POLL_S)
        if size == self._size:
            lines = self._lines
            length = _check(
                self._others, self._other_scales, self._buffer, self._values, self._text, tick,
                0 if lines is None else lines.time_us,
            )  # fmt: skip
            if length >= 0:
                self._usual += 1
                if lines is not None:
                    lines.add(bytes(self._characters[:length]), len(self._others))
                found: list[float] = self._values.tolist()
                return found
        if size:
            self._bus.unread(bytes(self._read[:size]))
        for checker in self._checkers:
            checker.go_on(self._usual)
        self._ready, self._usual = False, 0
        return None

    def _follow(self) -> bool:
        """Take the counters from the receivers."""
        for at, checker in enumerate(self._checkers):
            counter = checker.expected
            if counter is None:
                return False
            self._others[at, _COUNTER] = counter
        self._ready = True
        return True


@cache
def warm_up() -> None:
    """Compile, or load from the cache, before the first tick and before a process is forked."""
    whole, scales = np.zeros((1, 6), np.int64), np.ones((1, 6))
    text, frames = np.zeros(LINE_BYTES, np.uint8), np.zeros((1, _WORDS), np.int64)
    _pack(whole, scales, frames, text, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0)
    _check(whole, scales, frames.ravel(), np.zeros(1), text, 0, 0)


def _constants(codecs: Sequence[MessageCodec]) -> tuple[Any, Any]:
    """Whole numbers (n, 6) and scales (n, 6) of the codecs."""
    whole, scales = [], []
    for codec in codecs:
        layout, data_id = codec.layout, codec.data_id
        assert isinstance(layout, RigLayout) and data_id is not None
        shifts = layout.shifts if layout.has_status else (_NO_MODE, _NO_MODE)
        whole.append([codec.frame_id, crc_of_id(data_id), 0, *shifts, layout.verdict_bits])
        scales.append([
            codec.lsb, codec.minimum, codec.maximum, codec.raw_minimum, codec.raw_maximum,
            codec.not_available,
        ])  # fmt: skip
    return np.array(whole, np.int64), np.array(scales, np.float64)


@compiled
def _crc_of(data: int, of_id: int) -> int:
    crc = of_id
    for byte in range(1, FRAME_BYTES):
        crc ^= CRC_TABLES[byte - 1, data >> (8 * byte) & 255]
    return crc


@compiled
def _pack(
    codecs: Any,
    scales: Any,
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
        lsb, minimum, maximum, raw_minimum, raw_maximum, not_available = scales[row]
        raw = int(raw_value(value, lsb, minimum, maximum, raw_minimum, raw_maximum, not_available))
        bits = codecs[row, _COUNTER]
        if codecs[row, _MODE_SHIFT] != _NO_MODE:
            bits |= min(max(mode, 0), 3) << codecs[row, _MODE_SHIFT]
            bits |= min(max(fault_state, 0), 3) << codecs[row, _FAULT_STATE_SHIFT]
        spare = codecs[row, _VERDICT_BITS]
        raw = raw << spare | min(max(verdict, 0), (1 << spare) - 1)
        data = raw << 32 | (tick & 0xFFFF) << 16 | bits << 8
        data |= _crc_of(data, codecs[row, _CRC])
        frames[row, _DATA] = data
        codecs[row, _COUNTER] = (codecs[row, _COUNTER] + 1) % COUNTERS
        if len(text) > 0:
            at = write_line(text, at, time_us + row, codecs[row, _IDENTIFIER], data, True)
    return at


@compiled
def _check(
    codecs: Any, scales: Any, words: Any, values: Any, text: Any, tick: int, time_us: int
) -> int:
    """Read the values of a burst, and write its log lines; returns the length of the lines.

    Returns -1 and changes no counter where a frame is not the next frame of ``tick``.
    """
    at = 0
    for row in range(len(codecs)):
        header, data = words[row * _WORDS + _HEADER], words[row * _WORDS + _DATA]
        if header != codecs[row, _IDENTIFIER] | FRAME_BYTES << 40:
            return -1
        if data >> 16 & 0xFFFF != tick & 0xFFFF or data >> 8 & 15 != codecs[row, _COUNTER]:
            return -1
        if data & 255 != _crc_of(data, codecs[row, _CRC]):
            return -1
        raw = data >> (32 + codecs[row, _VERDICT_BITS])
        values[row] = np.nan
        if scales[row, 3] <= raw <= scales[row, 4]:
            values[row] = raw * scales[row, 0]
        if len(text) > 0:
            at = write_line(text, at, time_us + row, codecs[row, _IDENTIFIER], data, False)
    for row in range(len(codecs)):
        codecs[row, _COUNTER] = (codecs[row, _COUNTER] + 1) % COUNTERS
    return at
