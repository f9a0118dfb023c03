"""The tick on the wire: the low 16 bits of an hours-long count."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

WIRE_TICKS: Final = 1 << 16
_HALF: Final = WIRE_TICKS // 2
_AT: Final = slice(2, 4)  # of a frame's bytes


def tick_on(data: bytes | bytearray) -> int:
    """The tick in a frame's bytes, modulo 65536; from a short frame the available bytes."""
    return int.from_bytes(data[_AT], "little")


def ticks_on(data: NDArray[np.uint8]) -> NDArray[np.int64]:
    """The ticks of many frames: (frames, 4 bytes or more) → (frames,)."""
    return data[:, 2].astype(np.int64) | data[:, 3].astype(np.int64) << 8


def ticks_ahead(wire_tick: int, tick: int) -> int:
    """How far a frame is ahead of ``tick``: half of the 16 bits are the past, -32768..32767."""
    return (wire_tick - tick + _HALF) % WIRE_TICKS - _HALF


def tick_from(wire_tick: int, tick: int) -> int:
    """The first tick from ``tick`` on of which the wire carries ``wire_tick``."""
    return tick + (wire_tick - tick) % WIRE_TICKS


def tick_at(wire_tick: int, time_s: float, tick_s: float) -> int:
    """The tick of a frame from its 16 bits and its time stamp, if that is in virtual time."""
    tick = round((time_s / tick_s - wire_tick) / WIRE_TICKS) * WIRE_TICKS + wire_tick
    return tick if abs(tick * tick_s - time_s) < tick_s else wire_tick
