"""A DBC frame for every tick of a run at once: the arrays of `codec` and `protection`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from can_rig.frames.codec import MessageCodec
from can_rig.frames.crc_columns import UInt8s, crcs
from can_rig.frames.layout import RigLayout
from can_rig.frames.protection import COUNTERS, FRAME_BYTES
from can_rig.frames.wire_tick import WIRE_TICKS
from firmware_model.compiled import compiled
from firmware_model.target.structs import FloatArray

Ints = NDArray[np.int64]


def payloads(
    codec: MessageCodec,
    values: FloatArray,
    first_tick: int,
    mode: Ints | None = None,
    fault_state: Ints | None = None,
    verdict: Ints | None = None,
) -> UInt8s:
    """(n, 8), the next frames of a `Transmitter` after a frame in every tick from 0.

    Args:
        codec: a frame with the rig's layout.
        values: (n,), in the unit of the DBC; see `MessageCodec.encode`.
        first_tick: that of the first value.
        mode: (n,), of the status frame.
        fault_state: (n,), likewise.
        verdict: (n,), likewise; ignored for a frame without a verdict.
    """
    layout, data_id = codec.layout, codec.data_id
    assert isinstance(layout, RigLayout) and data_id is not None
    ticks = first_tick + np.arange(len(values), dtype=np.int64)
    bits = ticks % COUNTERS
    if mode is not None and fault_state is not None:
        mode_shift, fault_state_shift = layout.shifts
        bits |= mode << mode_shift | fault_state << fault_state_shift
    data = np.zeros((len(values), FRAME_BYTES), dtype=np.uint8)
    data[:, 1] = bits
    data[:, 2:4] = (ticks % WIRE_TICKS).astype("<u2")[:, np.newaxis].view(np.uint8)
    raw = raw_values(codec, values)
    if layout.verdict_bits:
        raw = raw << layout.verdict_bits | (0 if verdict is None else verdict)
    data[:, 4:8] = raw.astype("<i4")[:, np.newaxis].view(np.uint8)
    data[:, 0] = crcs(data, data_id)
    return data


def raw_values(codec: MessageCodec, values: FloatArray) -> Ints:
    """(n,) raw values; see `MessageCodec.to_raw`."""
    limits = float(codec.lsb), float(codec.minimum), float(codec.maximum)
    ends = int(codec.raw_minimum), int(codec.raw_maximum), int(codec.not_available)
    return _raw(np.ascontiguousarray(values), limits, ends)


@compiled
def _raw(
    values: FloatArray, limits: tuple[float, float, float], ends: tuple[int, int, int]
) -> Ints:
    lsb, minimum, maximum = limits
    raw_minimum, raw_maximum, not_available = ends
    raw = np.empty(len(values), np.int64)
    for k in range(len(values)):
        if math.isnan(values[k]):
            raw[k] = not_available
        elif values[k] >= maximum:
            raw[k] = raw_maximum
        elif values[k] <= minimum:
            raw[k] = raw_minimum
        else:
            raw[k] = int(np.rint(values[k] / lsb))
    return raw


def quantised(codec: MessageCodec, values: FloatArray) -> FloatArray:
    """(n,) ``values`` at the receiver; see `MessageCodec.quantise`."""
    if codec.lsb == 0.0:  # a float
        return np.array([codec.quantise(value) for value in values.tolist()])
    received = raw_values(codec, values).astype(np.float64) * codec.lsb
    received[np.isnan(values)] = np.nan
    return received
