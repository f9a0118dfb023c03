"""Channels of an MDF 4 file: records → numbers, and payloads of whatever layout."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.logs.frames import UInt8s
from can_rig.logs.readers.binary.mdf_blocks import (
    FLOAT,
    FLOAT_BIG,
    SIGNED,
    SIGNED_BIG,
    UNSIGNED_BIG,
    VIRTUAL,
    VIRTUAL_MASTER,
    Channel,
    Conversion,
    MdfError,
)
from can_rig.logs.readers.binary.mdf_values import empty_rows
from firmware_model.compiled import compiled

_ONE_TO_ONE, _LINEAR, _VALUE_TO_TEXT, _RANGE_TO_TEXT = 0, 1, 7, 8
_NS_PER_S: Final = 1_000_000_000
_EXACT: Final = 1 << 53


def raw(channel: Channel, records: UInt8s, first: int) -> NDArray[Any]:
    """(n,) raw values in ``records``; of a virtual channel the numbers of the records.

    Args:
        channel: of 64 bits or fewer.
        records: (n, bytes).
        first: the number of the first one.

    Raises:
        MdfError: it does not lie within the records.
    """
    count, size = records.shape
    if channel.kind in (VIRTUAL, VIRTUAL_MASTER):
        return np.arange(first, first + count)
    width = (channel.bit_offset + channel.bit_count + 7) // 8
    if not 0 < width <= 8 or channel.byte_offset + width > size:
        raise MdfError(f"channel {channel.name} must lie within the {size} bytes of its records")
    is_big = channel.data_type in (UNSIGNED_BIG, SIGNED_BIG, FLOAT_BIG)
    kind = {FLOAT: "f", FLOAT_BIG: "f", SIGNED: "i", SIGNED_BIG: "i"}.get(channel.data_type, "u")
    whole = channel.bit_offset == 0 and channel.bit_count in (8, 16, 32, 64)
    if whole and not (kind == "f" and width == 1):
        dtype = np.dtype(f"{'>' if is_big else '<'}{kind}{width}")
        return np.ndarray((count,), dtype, records, channel.byte_offset, (size,))
    word = np.zeros(count, np.uint64)
    places = range(width) if not is_big else range(width - 1, -1, -1)
    for shift, byte in enumerate(places):
        word |= records[:, channel.byte_offset + byte].astype(np.uint64) << np.uint64(8 * shift)
    return word >> np.uint64(channel.bit_offset) & np.uint64((1 << channel.bit_count) - 1)


def numbers(channel: Channel, records: UInt8s, first: int) -> NDArray[Any]:
    """(n,) physical values; where they are words, 1 for "Tx" and others that say yes, else 0.

    Raises:
        MdfError: see `raw`; or the conversion is of a kind that is not read.
    """
    values = raw(channel, records, first)
    conversion = channel.conversion
    if conversion.kind == _ONE_TO_ONE:
        return values
    if conversion.kind == _LINEAR and len(conversion.values) >= 2:
        offset, factor = conversion.values[:2]
        return values if (offset, factor) == (0, 1) else offset + factor * values
    if conversion.kind in (_VALUE_TO_TEXT, _RANGE_TO_TEXT):
        if channel.kind != VIRTUAL:
            return values  # codes: 1 for Tx, whatever they are called
        return np.array([_says_yes(conversion, float(value)) for value in values], np.uint8)
    raise MdfError(
        f"channel {channel.name} has a conversion of type {conversion.kind}, not 0, 1, 7 or 8"
    )


def _says_yes(conversion: Conversion, value: float) -> bool:
    step = 1 if conversion.kind == _VALUE_TO_TEXT else 2
    lows, highs = conversion.values[::step], conversion.values[step - 1 :: step]
    pairs = enumerate(zip(lows, highs, strict=False))
    at = next((i for i, (low, high) in pairs if low <= value <= high), len(lows))
    return conversion.words[at : at + 1] in (("Tx",), ("1",), ("true",))


def time_ns(channel: Channel, records: UInt8s, first: int) -> NDArray[np.int64]:
    """(n,) time stamps since the start of the recording, to the nearest nanosecond.

    Raises:
        MdfError: see `numbers`; or one is not within 146 years.
    """
    conversion = channel.conversion
    if channel.kind == VIRTUAL_MASTER or conversion.kind == _LINEAR:
        offset, factor = conversion.values[:2] if len(conversion.values) > 1 else (0.0, 1.0)
        ticks = raw(channel, records, first)
        step_ns = factor * _NS_PER_S
        if ticks.dtype.kind in "ui" and offset == 0 and step_ns >= 1 and step_ns < _EXACT:
            nearest = round(step_ns)
            if abs(step_ns - nearest) <= 1e-9 * step_ns:
                if len(ticks) and int(ticks.max()) > (1 << 62) // nearest:
                    raise MdfError("a time stamp later than 146 years after the start")
                return ticks.astype(np.int64) * nearest
    with np.errstate(invalid="ignore", over="ignore"):
        stamps = np.round(numbers(channel, records, first).astype(np.float64) * _NS_PER_S)
    if not (np.abs(stamps) < 1 << 62).all():
        raise MdfError("a time stamp that is no number, or later than 146 years after the start")
    return stamps.astype(np.int64)


def payloads(channel: Channel, records: UInt8s, length: UInt8s) -> UInt8s:
    """(n, 8) or (n, 64) bytes of a channel of fixed size; zero behind the lengths.

    Raises:
        MdfError: it does not lie within the records.
    """
    width = channel.elements if channel.elements > 1 else channel.bit_count // 8
    if channel.byte_offset + width > records.shape[1]:
        raise MdfError(f"channel {channel.name} must lie within the bytes of its records")
    rows = empty_rows(length)
    copy_fixed(records, channel.byte_offset, width, length, rows)
    return rows


@compiled
def copy_fixed(records: UInt8s, at: int, width: int, length: UInt8s, rows: UInt8s) -> None:
    """Fill ``rows`` with as many bytes of each record as there are."""
    for row in range(len(rows)):
        size = min(width, np.int64(length[row]), rows.shape[1])
        for byte in range(size):
            rows[row, byte] = records[row, at + byte]
        for byte in range(size, rows.shape[1]):
            rows[row, byte] = 0
