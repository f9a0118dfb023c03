"""One frame: the conversion between a record and its bytes.

A value outside the range of its signal saturates; it never wraps and never raises. NOT_AVAILABLE, a
raw value outside the range, stands for not-a-number; no receiver uses NOT_AVAILABLE. A float sends
its own not-a-number.

The value counts in steps of the signal's factor. ``layout`` packs the steps into bytes: the rig's
layout, or any other layout through cantools.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from can_rig.frames.layout import Layout, RigLayout


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
