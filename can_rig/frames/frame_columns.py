"""A DBC frame for every tick of a run at once: the arrays of `codec`.

A CRC is linear in the covered bits: the exclusive or of a table value per byte of the frame, and of
a constant for the data identifier. The E2E library computes the tables, so that only the library
contains the polynomial.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from e2e.p01 import e2e_p01_protect
from numpy.typing import NDArray

from can_rig.frames.codec import COUNTERS, FRAME_BYTES, MessageCodec, RigLayout
from firmware_model.compiled import compiled
from firmware_model.law.structs import FloatArray

UInt8s = NDArray[np.uint8]


def crcs(data: UInt8s, data_id: int) -> UInt8s:
    """(n,) CRC for byte 0 of payloads (n, 8 or more)."""
    found: UInt8s = np.empty(len(data), dtype=np.uint8)
    _crcs(data, np.uint8(crc_of_id(data_id)), found)
    return found


@compiled
def _crcs(data: UInt8s, of_id: Any, found: UInt8s) -> None:
    for row in range(len(data)):
        crc = of_id
        for byte in range(1, FRAME_BYTES):
            crc ^= CRC_TABLES[byte - 1, data[row, byte]]
        found[row] = crc


def crc_of_id(data_id: int) -> int:
    """The CRC of a frame of zeros."""
    return _crc(bytearray(FRAME_BYTES), data_id)


def _tables() -> Any:
    """(7, 256) contribution of every value of bytes 1 to 7 to the CRC."""
    nothing = crc_of_id(0)
    tables = np.zeros((FRAME_BYTES - 1, 256), dtype=np.uint8)
    for byte in range(1, FRAME_BYTES):
        for value in range(256):
            frame = bytearray(FRAME_BYTES)
            frame[byte] = value
            tables[byte - 1, value] = _crc(frame, 0) ^ nothing
    return tables


def _crc(frame: bytearray, data_id: int) -> int:
    e2e_p01_protect(frame, data_id, increment_counter=False)
    return frame[0]


CRC_TABLES = _tables()

Ints = NDArray[np.int64]


def payloads(
    codec: MessageCodec,
    values: FloatArray,
    first_tick: int,
    mode: Ints | None = None,
    fault_state: Ints | None = None,
    verdict: Ints | None = None,
    counts: Ints | None = None,
) -> UInt8s:
    """(n, 8), the next frames of a `Transmitter` after a frame in every tick from 0.

    Args:
        codec: a frame with the rig's layout.
        values: (n,), in the unit of the DBC; see `MessageCodec.encode`.
        first_tick: that of the first value.
        mode: (n,), of the status frame.
        fault_state: (n,), likewise.
        verdict: (n,), likewise; ignored for a frame without a verdict.
        counts: (n,), the number of frames before each, of a sender that began at another tick.
    """
    if counts is None:
        counts = np.arange(first_tick, first_tick + len(values))
    nothing, words = np.zeros(len(values), np.int64), np.empty(len(values), "<i8")
    whole, scales = constants([codec])
    modes, states, verdicts = (
        nothing if each is None else each for each in (mode, fault_state, verdict)
    )
    values = np.ascontiguousarray(values)
    _words(whole, scales, values, first_tick, modes, states, verdicts, counts, words)
    return words.view(np.uint8).reshape(-1, FRAME_BYTES)


@compiled
def _words(
    codecs: Any,
    scales: Any,
    values: Any,
    first_tick: int,
    mode: Any,
    fault_state: Any,
    verdict: Any,
    counts: Any,
    words: Any,
) -> None:
    for k in range(len(values)):
        words[k] = frame_word(
            codecs, scales, 0, values[k], first_tick + k, counts[k] % COUNTERS, mode[k],
            fault_state[k], verdict[k],
        )  # fmt: skip


IDENTIFIER, CRC, MODE_SHIFT, FAULT_STATE_SHIFT, VERDICT_BITS = range(5)
"""Columns of the whole numbers of ``constants``."""

_NO_MODE: Final = -1


def constants(codecs: Sequence[MessageCodec]) -> tuple[Any, Any]:
    """Whole numbers (n, 5) and scales (n, 6) of frames of every tick, with the rig's layout."""
    whole, scales = [], []
    for codec in codecs:
        layout, data_id = codec.layout, codec.data_id
        assert isinstance(layout, RigLayout) and data_id is not None
        shifts = layout.shifts if layout.has_status else (_NO_MODE, _NO_MODE)
        whole.append([codec.frame_id, crc_of_id(data_id), *shifts, layout.verdict_bits])
        scales.append([
            codec.lsb, codec.minimum, codec.maximum, codec.raw_minimum, codec.raw_maximum,
            codec.not_available,
        ])  # fmt: skip
    return np.array(whole, np.int64), np.array(scales, np.float64)


@compiled
def frame_word(
    codecs: Any,
    scales: Any,
    row: int,
    value: float,
    tick: int,
    counter: int,
    mode: int,
    fault_state: int,
    verdict: int,
) -> int:
    """The 8 bytes of a frame, the lowest first; see `MessageCodec.encode` and `Protector`."""
    lsb, minimum, maximum, _, _, not_available = scales[row]
    raw = int(not_available)
    if not math.isnan(value):
        raw = int(np.rint(min(max(value, minimum), maximum) / lsb))
    bits = counter
    if codecs[row, MODE_SHIFT] != _NO_MODE:
        bits |= min(max(mode, 0), 3) << codecs[row, MODE_SHIFT]
        bits |= min(max(fault_state, 0), 3) << codecs[row, FAULT_STATE_SHIFT]
    spare = codecs[row, VERDICT_BITS]
    raw = raw << spare | min(max(verdict, 0), (1 << spare) - 1)
    data = raw << 32 | (tick & 0xFFFF) << 16 | bits << 8
    word: int = data | crc_of(data, codecs[row, CRC])
    return word


@compiled
def crc_of(data: int, of_id: int) -> int:
    """The CRC of a frame's 8 bytes, given the CRC of zeros with the same data identifier."""
    crc = of_id
    for byte in range(1, FRAME_BYTES):
        crc ^= CRC_TABLES[byte - 1, data >> (8 * byte) & 255]
    return crc


def quantised(codec: MessageCodec, values: FloatArray) -> FloatArray:
    """(n,) ``values`` at the receiver; see `MessageCodec.quantise`."""
    if codec.lsb == 0.0:  # a float
        return np.array([codec.quantise(value) for value in values.tolist()])
    inside = np.clip(values, codec.minimum, codec.maximum)
    received: FloatArray = np.rint(inside / codec.lsb) * codec.lsb + 0.0  # no -0.0: whole steps
    return received
