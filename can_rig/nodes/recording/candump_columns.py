"""The lines of ``bus.log`` for many ticks at once: what `recorder` writes of one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.frames.crc_columns import UInt8s
from can_rig.frames.protection import FRAME_BYTES
from can_rig.nodes.recording.recorder import CHANNEL
from firmware_model.compiled import compiled

HEXADECIMAL: Final = np.frombuffer(b"0123456789ABCDEF", np.uint8)
SECONDS_DIGITS: Final = 10
LINE_BYTES: Final = 1 + SECONDS_DIGITS + 7 + len(f") {CHANNEL} 7FF#") + 2 * FRAME_BYTES + 3
"""No line is longer."""


def candump_bytes(
    data: UInt8s,
    there: NDArray[np.bool_],
    first_us: NDArray[np.int64],
    ids: Sequence[int],
    own: int,
) -> memoryview:
    """The lines of all frames that are there, the n-th of a tick n µs after its first.

    Args:
        data: (ticks, frames, 8), payloads in their order on the bus.
        there: (ticks, frames), whether a frame was sent.
        first_us: (ticks,), when each tick begins, µs.
        ids: the identifier of each frame of a tick.
        own: how many of the first ones the recording node has sent itself.
    """
    heads = np.frombuffer(
        b"".join(f") {CHANNEL} {identifier:03X}#".encode("ascii") for identifier in ids), np.uint8
    ).reshape(len(ids), -1)
    text = np.empty(int(there.sum()) * LINE_BYTES, dtype=np.uint8)
    length = _lines(data, there, first_us, heads, own, text)
    return text[:length].data


@compiled
def _lines(data: Any, there: Any, first_us: Any, heads: Any, own: int, text: Any) -> int:
    zero, at = 48, 0
    for tick in range(data.shape[0]):
        time_us = first_us[tick]
        for frame in range(data.shape[1]):
            if not there[tick, frame]:
                continue
            text[at] = 40  # (
            at += 1
            seconds, part = time_us // 1_000_000, time_us % 1_000_000
            digits, rest = 1, seconds // 10
            while rest > 0:
                digits += 1
                rest //= 10
            for place in range(digits):
                text[at + digits - 1 - place] = zero + seconds % 10
                seconds //= 10
            at += digits
            text[at] = 46  # .
            for place in range(6):
                text[at + 6 - place] = zero + part % 10
                part //= 10
            at += 7
            for byte in heads[frame]:
                text[at] = byte
                at += 1
            for byte in data[tick, frame]:
                text[at] = HEXADECIMAL[byte >> 4]
                text[at + 1] = HEXADECIMAL[byte & 15]
                at += 2
            text[at] = 32
            text[at + 1] = 84 if frame < own else 82  # T, R
            text[at + 2] = 10
            at += 3
            time_us += 1
    return at
