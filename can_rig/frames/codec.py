"""One frame: record ↔ protected bytes, and its two ends on the bus.

**Content.** A value outside the range of its signal saturates; it never wraps and never raises.
NOT_AVAILABLE, a raw value outside the range, stands for not-a-number; no receiver uses
NOT_AVAILABLE. A float sends its own not-a-number.

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

**Protection.** AUTOSAR end-to-end protection, profile 1 (variant 1A), of a frame of any length.

Byte 0 is a CRC-8 (SAE J1850, polynomial 0x1D) over the low byte and the high byte of the data
identifier and the bytes from 1 on; the low nibble of byte 1 is a counter 0..14. The CRC detects
damage and a frame of another sender, the counter detects repetition, loss and wrong order. The CRC
detects every burst of up to 8 bits, except for 5 of the 769 across bytes 0 and 1: the polynomial
needs the CRC after the data, and the profile sends the CRC first. CAN's CRC-15 detects these
bursts.

Source: AUTOSAR SWS E2E Library (Doc. 428), "Specification of E2E Profile 1": data identifier mode
E2E_P01_DATAID_BOTH, E2E_P01Protect and E2E_P01Check. Configuration: SyncCounterInit is 1;
MaxDeltaCounterInit is 1;
MaxNoNewOrRepeatedData is 14, which disables its monitor.

**Ends.** `Transmitter` and `Receiver`; `Hearing` receives further sensors, whose frames come with
periods of their own.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from struct import Struct
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from can import Message
from e2e.p01 import e2e_p01_check, e2e_p01_protect

FRAME_BYTES: Final = 8
"""Length of every frame of the rig's own [byte]."""

COUNTERS: Final = 15
"""Counters are 0..14; 15 is never sent."""

_LARGEST_DELTA: Final = COUNTERS - 1
_AFTER: Final = (*range(1, COUNTERS), 0)  # the successor of each counter
_SYNC_COUNTER_INIT: Final = 1


class CheckStatus(IntEnum):
    """Result of checking one frame: E2E_P01CheckStatusType, extended by the rig."""

    OK = 0
    """The next frame."""
    INITIAL = 1
    """The first intact frame of a run; no earlier counter exists."""
    OK_SOME_LOST = 2
    """An intact frame, newer than the last frame, after a tolerated number of losses."""
    REPEATED = 3
    """The last frame's counter again."""
    WRONG_SEQUENCE = 4
    """Too many frames lost, or an old frame."""
    SYNC = 5
    """In sequence again after WRONG_SEQUENCE, but not yet confirmed."""
    WRONG_CRC = 6
    """A damaged frame, another sender's frame, or the counter 15, which no sender uses."""
    WRONG_LENGTH = 7
    """Another length than the codec's."""
    NO_NEW_DATA = 8
    """A missing frame."""
    WRONG_TICK = 9
    """Intact, but from another tick; the counter is left unchecked."""


USABLE: Final = (CheckStatus.OK, CheckStatus.INITIAL, CheckStatus.OK_SOME_LOST)
"""The statuses of usable frames; frames of other statuses update nothing."""

# Module constants: a lookup in the enumeration costs as much as the rest of a check.
_OK, _INITIAL, _OK_SOME_LOST = USABLE
_REPEATED, _WRONG_SEQUENCE = CheckStatus.REPEATED, CheckStatus.WRONG_SEQUENCE
_SYNC, _WRONG_CRC, _WRONG_LENGTH = CheckStatus.SYNC, CheckStatus.WRONG_CRC, CheckStatus.WRONG_LENGTH
_WRONG_TICK = CheckStatus.WRONG_TICK


def _require_data_id(data_id: int) -> int:
    if not 0 <= data_id <= 0xFFFF:
        raise ValueError(f"data_id is {data_id}; it must be 0..65535")
    return data_id


class Protector:
    """The sending end of one protected frame (E2E_P01Protect).

    Args:
        data_id: 16-bit identifier of the frame, known to both ends and never sent itself.

    Raises:
        ValueError: `data_id` is not 16-bit unsigned.
    """

    __slots__ = ("_counter", "data_id")

    def __init__(self, data_id: int) -> None:
        self.data_id: Final = _require_data_id(data_id)
        self._counter = _LARGEST_DELTA  # sends 0 first, following SWS E2E

    def protect(self, data: bytearray) -> None:
        """Write the next counter and the CRC into `data`, in place."""
        # The library increments the counter in the frame; 0 follows 14.
        data[1] = (data[1] & 0xF0) | self._counter
        e2e_p01_protect(data, self.data_id)
        self._counter = data[1] & 0x0F


class Checker:
    """The receiving end of one protected frame (E2E_P01Check).

    Call `check` for every arrived frame, and `no_new_data` for every missing frame. Each call
    without a usable frame widens the tolerated counter step by one, because the sender continues
    counting; a usable frame resets the step to 1. After a larger step the
    received counter is adopted, and one more frame in sequence (SYNC) is needed before the content
    is used again.

    Args:
        data_id: identifier of the frame, as at the sender.
        length: of its frames [byte].

    Raises:
        ValueError: an argument out of range.
    """

    __slots__ = ("_counts", "_last", "_length", "_next", "_sync", "_window", "data_id")

    def __init__(self, data_id: int, length: int = FRAME_BYTES) -> None:
        self.data_id: Final = _require_data_id(data_id)
        self._length = length
        self._last: int | None = None  # counter of the last accepted frame
        self._next: int | None = None  # the counter of an OK frame; None where that is not enough
        self._window = 1  # largest tolerated step at the last call
        self._sync = 0  # frames in sequence still needed before use
        self._counts = [0] * len(CheckStatus)

    @property
    def expected(self) -> int | None:
        """The counter of a next frame that is OK; None where another status is next."""
        return self._next

    def go_on(self, frames: int) -> None:
        """Count frames that were found OK elsewhere, one in each of as many calls."""
        if frames and self._next is not None:
            self._last = (self._next + frames - 1) % COUNTERS
            self._next = _AFTER[self._last]
            self._window = 1
            self._counts[_OK] += frames

    @property
    def counts(self) -> dict[CheckStatus, int]:
        """Number of frames with each status since the start."""
        return dict(zip(CheckStatus, self._counts, strict=True))

    def check(self, data: bytearray) -> CheckStatus:
        """Judge one received frame; never raises, whatever its content or length."""
        intact = len(data) == self._length and e2e_p01_check(data, self.data_id)
        if intact and data[1] & 0x0F == self._next:  # the usual case, made quick
            self._last, self._next = self._next, _AFTER[self._next]
            self._window = 1
            self._counts[_OK] += 1
            return _OK
        self._window += 1  # SWS E2E limits the window to 14, which tolerates every step
        status = self._judge(data[1] & 0x0F) if intact else self._damage(data)
        self._counts[status] += 1
        return status

    def reject(self, data: bytearray) -> None:
        """Count a frame of another tick, without further effect.

        A forged frame therefore needs the current tick to disturb the counter.
        """
        intact = len(data) == self._length and e2e_p01_check(data, self.data_id)
        self._counts[_WRONG_TICK if intact else self._damage(data)] += 1

    def _damage(self, data: bytearray) -> CheckStatus:
        """The status of a damaged frame."""
        return _WRONG_LENGTH if len(data) != self._length else _WRONG_CRC

    def no_new_data(self) -> CheckStatus:
        """Record a missing frame."""
        self._window += 1
        self._counts[CheckStatus.NO_NEW_DATA] += 1
        return CheckStatus.NO_NEW_DATA

    def _judge(self, received: int) -> CheckStatus:
        """Compare the counter of an intact frame, not OK, with the last frame's counter."""
        if self._last is None:
            return self._accept(received, _INITIAL)
        delta = (received - self._last) % COUNTERS
        if delta == 0:
            return _REPEATED
        if delta > self._window:
            self._sync = _SYNC_COUNTER_INIT
            return self._accept(received, _WRONG_SEQUENCE)
        if self._sync:
            self._sync -= 1
            return self._accept(received, _SYNC)
        return self._accept(received, _OK_SOME_LOST)

    def _accept(self, received: int, status: CheckStatus) -> CheckStatus:
        """Adopt this counter, with the initial tolerance."""
        self._last = received
        self._next = None if self._sync else _AFTER[received]
        self._window = 1
        return status


class Unprotected(Checker):
    """The receiving end of a frame without protection: only the length decides."""

    __slots__ = ()

    def __init__(self, length: int) -> None:
        super().__init__(0, length=length)

    def check(self, data: bytearray) -> CheckStatus:
        """As that of `Checker`."""
        status = _OK if len(data) == self._length else _WRONG_LENGTH
        self._counts[status] += 1
        return status

    def reject(self, data: bytearray) -> None:
        """As that of `Checker`."""
        self._counts[_WRONG_TICK if len(data) == self._length else _WRONG_LENGTH] += 1


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
        self._ids = {codec.frame_id for codec in codecs}
        self._silence: Final = MappingProxyType(nothing_heard(names))
        self._now: dict[str, float] = {}

    def concerns(self, message: Message) -> bool:
        """Whether ``message`` has the identifier of a further sensor."""
        return message.arbitration_id in self._ids

    def take(self, message: Message, tick: int | None) -> None:
        """Take in a frame of ``tick``; None: of any. A frame marked invalid has no value.

        A frame of a foreign database says neither a validity nor the tick of its sample.
        """
        for name, receiver in zip(self._names, self.receivers, strict=True):
            if receiver.codec.frame_id != message.arbitration_id:
                continue
            record, says = receiver.accept(message, tick), receiver.codec.modes
            if record is not None:
                self._now = self._now or nothing_heard(self._names)
                self._now[name] = record.value if record.mode or not says else math.nan
                age = (record.tick - record.verdict) % (1 << SAMPLE_BITS)
                self._now[name + AGE] = age if says else math.nan

    def end_tick(self, tick: int) -> Mapping[str, float]:
        """What ``tick`` has brought: value and age of the sample, not a number where none came."""
        if not self.receivers:
            return NOTHING
        for receiver, (period, phase, _) in zip(self.receivers, self._timings, strict=True):
            if tick >= phase and (tick - phase) % period == 0:
                receiver.end_tick()
        found, self._now = self._now or self._silence, {}
        return found


def nothing_heard(names: Sequence[str]) -> dict[str, float]:
    """Value and age of the samples of sensors that sent nothing."""
    return {name + end: math.nan for name in names for end in ("", AGE)}


WIRE_TICKS: Final = 1 << 16
_HALF: Final = WIRE_TICKS // 2
_AT: Final = slice(2, 4)  # of a frame's bytes


def tick_on(data: bytes | bytearray) -> int:
    """The tick in a frame's bytes, modulo 65536; from a short frame the available bytes."""
    return int.from_bytes(data[_AT], "little")


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


class Coding(NamedTuple):
    """A raw value as steps: sign · (raw + from_zero)."""

    sign: int = 1
    from_zero: int = 0
    is_signed: bool = True
    """Whether raw is a two's complement."""


class Layout(Protocol):
    """The conversion between a frame's content and its bytes."""

    @property
    def coding(self) -> Coding:
        """The value's; a float has none."""

    @property
    def places(self) -> Mapping[str, Sequence[int]]:
        """Bits of the frame by a field's name in ``Record``, from the field's lowest bit on.

        Bit 0 is the lowest of byte 0.
        """

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
    coding: Final = Coding()

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
        self.places: Final[Mapping[str, Sequence[int]]] = {
            "value": range(32 + low_bits, 64),
            "tick": range(16, 32),
            "verdict": range(32, 32 + low_bits),
            **{
                name: range(8 + shift, 8 + shift + mask.bit_length())
                for name, shift, mask in zip(
                    ("mode", "fault_state"), shifts or (), masks, strict=False
                )
            },
        }

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


NO_RECORD: Final = Record(math.nan, -1)
"""In place of a frame that has not come: of no tick."""


@dataclass(frozen=True, slots=True)
class MessageCodec:
    """One frame: its definition in the DBC, and the conversion between its value and its bytes."""

    role: str
    name: str
    frame_id: int
    """CAN identifier."""
    data_id: int | None
    """E2E data identifier; None: the frame is not protected."""
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


class Transmitter:
    """The sending end of one frame: codec, then protection."""

    def __init__(self, codec: MessageCodec) -> None:
        self.codec: Final = codec
        self._protector = None if codec.data_id is None else Protector(codec.data_id)

    def frame(
        self, value: float, tick: int, mode: int = 0, fault_state: int = 0, verdict: int = 0
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
    """The receiving end of one frame: protection, then codec."""

    def __init__(self, codec: MessageCodec) -> None:
        self.codec: Final = codec
        length = codec.layout.length
        self.checker: Final[Checker] = (
            Unprotected(length) if codec.data_id is None else Checker(codec.data_id, length)
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


def is_frame_of(codecs: Iterable[MessageCodec], message: Message) -> bool:
    """Whether ``message`` is a frame of ``codecs``: kind, length and CRC, with any counter."""
    return any(
        message.arbitration_id == codec.frame_id and Receiver(codec).accept(message) is not None
        for codec in codecs
    )
