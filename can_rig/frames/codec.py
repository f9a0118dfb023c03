"""One frame: the conversion between a record and its bytes.

A value outside the range of its signal saturates; it never wraps and never raises. NOT_AVAILABLE, a
raw value outside the range, stands for not-a-number; no receiver uses NOT_AVAILABLE. A float sends
its own not-a-number.

The value counts in steps of the signal's factor. ``layout`` packs the steps into bytes: the rig's
layout, or any other layout through cantools. The rig's layout is, in Intel byte order, in classic
frames with 11-bit identifiers:

| bytes | content                                                                              |
|-------|--------------------------------------------------------------------------------------|
| 0     | `Checksum`, CRC-8 of AUTOSAR E2E profile 1                                           |
| 1     | low nibble `AliveCounter`; high nibble `Mode` and `FaultState` in the status frame   |
| 2, 3  | `Tick`, unsigned: the low 16 bits of an hours-long count                             |
| 4..7  | the value, signed, scaled; in the status frame 28 bits, above 4 bits of `Verdict`    |

The frame of a further sensor has `Valid` in byte 1, and 20 bits of value above 12 of `SampleTick`.
To the codec, `Valid` is a mode, and `SampleTick` a verdict: the bits that go along with a value.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from struct import Struct
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from can_rig.frames.protection import FRAME_BYTES

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


FRAME: Final = Struct("<BBHi")
"""Checksum; counter and status bits; tick; raw value."""

Unpacked = tuple[float, int, int, int, int]
"""A frame's content: steps of the value's factor, tick, mode, fault state, verdict."""

ROLES: Final = ("reference", "feedback", "command_1", "command_2", "status")
"""The roles of the frames of every tick, in their order on the bus."""

SPEED: Final = "speed"
"""The role of an additional first frame; only for a car with changing speed."""

VERDICT_BITS: Final = 4

SAMPLE_BITS: Final = 12
"""Bits of the sample's tick, below the value in the frame of a further sensor."""

VALID_SHIFT: Final = 4
"""Place of the validity within byte 1 of such a frame."""

NO_DECISION: Final = 14
"""The code of ``Verdict`` of a controller that says neither a verdict nor a fault state."""

NO_VERDICT: Final = 15
"""The code of ``Verdict`` of a controller that says a fault state and no verdict."""


class Layout(Protocol):
    """The conversion between a frame's content and its bytes."""

    @property
    def length(self) -> int:
        """Bytes of the frame."""

    @property
    def has_tick(self) -> bool:
        """Whether the frame carries its tick."""

    def pack(self, k: float, tick: int, mode: int, fault_state: int, verdict: int) -> bytearray:
        """The bytes of a frame, its protection still zero; the tick is taken modulo 65536."""

    def unpack(self, data: bytes | bytearray) -> Unpacked:
        """The content of a frame of the right length."""

    def tick(self, data: bytes | bytearray) -> int | None:
        """The frame's tick, modulo 65536, for any length; None for a frame without a tick."""


class RigLayout:
    """The rig's layout: one ``struct`` call, bit for bit equal to cantools and ten times as fast.

    Args:
        shifts: of mode and fault state in byte 1; None for a frame without them.
        low_bits: the low bits of the value that carry the verdict or the sample's tick.
        masks: the largest mode and fault state.
    """

    length: Final = FRAME_BYTES
    has_tick: Final = True

    def __init__(
        self,
        shifts: tuple[int, int] | None = None,
        low_bits: int = 0,
        masks: tuple[int, int] = (3, 3),
    ) -> None:
        self.shifts: Final = shifts or (0, 0)
        self.masks: Final = masks
        self.verdict_bits: Final = low_bits
        self._most = (1 << self.verdict_bits) - 1
        self.has_status: Final = shifts is not None

    def pack(self, k: float, tick: int, mode: int, fault_state: int, verdict: int) -> bytearray:
        """See ``Layout``."""
        bits, value = 0, int(k) << self.verdict_bits | min(max(verdict, 0), self._most)
        if self.has_status:
            bits = min(max(mode, 0), self.masks[0]) << self.shifts[0]
            bits |= min(max(fault_state, 0), self.masks[1]) << self.shifts[1]
        return bytearray(FRAME.pack(0, bits, tick & 0xFFFF, value))

    def unpack(self, data: bytes | bytearray) -> Unpacked:
        """See ``Layout``."""
        _, bits, tick, raw = FRAME.unpack(data)
        if not self.has_status:
            return raw, tick, 0, 0, 0
        mode, fault_state = (
            bits >> shift & mask for shift, mask in zip(self.shifts, self.masks, strict=True)
        )
        return raw >> self.verdict_bits, tick, mode, fault_state, raw & self._most

    def tick(self, data: bytes | bytearray) -> int | None:
        """See ``Layout``."""
        return tick_on(data)


class Record(NamedTuple):
    """The content of one frame."""

    value: float
    """The signal, in the unit of the DBC; nan for NOT_AVAILABLE."""
    tick: int
    """Tick of the frame, modulo 65536."""
    mode: int = 0
    """Mode of the controller, a key of `MessageCodec.modes`; 0 in a frame without it."""
    fault_state: int = 0
    """State of the fault decision, a key of `MessageCodec.fault_states`; 0 likewise."""
    verdict: int = 0
    """Verdict on the fault's cause, a key of `MessageCodec.verdicts`; 0 likewise."""


@dataclass(frozen=True, slots=True)
class MessageCodec:
    """One frame: its definition in the DBC, and the conversion between its value and its bytes."""

    role: str
    name: str
    frame_id: int
    """CAN identifier."""
    sender: str
    """Sending node in the DBC."""
    data_id: int | None
    """E2E data identifier; None: the frame is not protected."""
    cycle_time_ms: int | None
    """GenMsgCycleTime [ms]; the rig sends at the tick of the scenario instead."""
    signal_name: str
    unit: str
    """Unit of the value in the DBC's spelling; empty where dimensionless."""
    lsb: float
    """Resolution of the value [unit]; 0 of a float."""
    raw_minimum: float
    raw_maximum: float
    """Steps of the value; of a float the value itself."""
    minimum: float
    """Smallest representable value [unit]."""
    maximum: float
    """Largest representable value [unit]."""
    not_available: float
    """Raw value for a missing value."""
    modes: Mapping[int, str]
    """Value table of Mode; empty for a frame without it."""
    fault_states: Mapping[int, str]
    """Value table of FaultState; empty for a frame without it."""
    verdicts: Mapping[int, str] = field(default_factory=dict)
    """Value table of Verdict; likewise."""
    layout: Layout = field(default_factory=RigLayout)
    extended: bool = False
    """Whether the identifier has 29 bits."""
    fd: bool = False
    """Whether the frame is CAN FD."""
    float_format: str = ""
    """The `struct` format of a float."""

    @property
    def protected(self) -> bool:
        """Whether E2E profile 1 protects it."""
        return self.data_id is not None

    def to_raw(self, value: float) -> float:
        """The steps nearest to ``value`` [unit], saturated; NOT_AVAILABLE for nan."""
        if self.float_format:
            return self._to_float(value)
        if self.minimum < value < self.maximum:
            return round(value / self.lsb)
        if value >= self.maximum:
            return self.raw_maximum
        return self.raw_minimum if value <= self.minimum else self.not_available

    def _to_float(self, value: float) -> float:
        if math.isnan(value):
            return math.nan
        inside = min(max(value, self.minimum), self.maximum)
        number: float = struct.unpack(self.float_format, struct.pack(self.float_format, inside))[0]
        return number

    def from_raw(self, raw: float) -> float:
        """The value of ``raw`` steps [unit]; nan for NOT_AVAILABLE and raw values out of range."""
        if self.raw_minimum <= raw <= self.raw_maximum:
            return raw * self.lsb if self.lsb else raw
        return math.nan

    def quantise(self, value: float) -> float:
        """A receiver's ``value`` [unit]: saturated, on the raw grid; nan stays nan."""
        return self.from_raw(self.to_raw(value))

    def encode(
        self, value: float, tick: int, mode: int = 0, fault_state: int = 0, verdict: int = 0
    ) -> bytearray:
        """The bytes of a frame, with counter and checksum still zero.

        ``value`` [unit] saturates; ``tick`` is reduced modulo 65536; ``mode``, ``fault_state`` and
        ``verdict`` saturate at their bits' ends in the status frame, and other frames ignore all
        three.
        """
        return self.layout.pack(self.to_raw(value), tick, mode, fault_state, verdict)

    def decode(self, data: bytes | bytearray) -> Record:
        """The content of a frame; counter and checksum are ignored.

        Raises:
            struct.error: ``data`` of a frame of the rig is not 8 bytes long.
        """
        raw, tick, mode, fault_state, verdict = self.layout.unpack(data)
        return Record(self.from_raw(raw), tick, mode, fault_state, verdict)
