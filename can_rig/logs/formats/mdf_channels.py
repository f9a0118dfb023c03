"""Channels of an MDF 4 file: records → numbers, and payloads of whatever layout."""

from __future__ import annotations

import re
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import one_line
from can_rig.logs.formats.mdf_blocks import (
    FLOAT,
    FLOAT_BIG,
    SIGNED,
    SIGNED_BIG,
    TEXTS,
    UNSIGNED_BIG,
    VIRTUAL,
    VIRTUAL_MASTER,
    Channel,
    Conversion,
    MdfError,
    MdfFile,
)
from can_rig.logs.formats.mdf_data import empty_rows
from can_rig.logs.frames import UInt8s
from firmware_model.compiled import compiled

_ONE_TO_ONE, _LINEAR, _FORMULA, _NEAREST, _VALUE_TO_TEXT, _RANGE_TO_TEXT = 0, 1, 3, 5, 7, 8
_ARITHMETIC: Final = re.compile(  # a formula goes through Python's `eval`, where powers may not end
    r"(?!.*\*\s*\*)(?:[X\d.eE+\-*/(),\s]|"
    r"(?:arc)?(?:sin|cos|tan)h?(?=\()|(?:exp|log|log10|sqrt|abs)(?=\())+",
    re.S,
)
_MOST_NUMBER: Final = (1 << 32) - 1
_YES: Final = ("Tx", "1", "true")
_NS_PER_S: Final = 1_000_000_000
_EXACT: Final = 1 << 53


def raw(channel: Channel, records: UInt8s, first: int) -> NDArray[Any]:
    """(n,) raw values in ``records``; of a virtual channel the numbers of the records.

    Args:
        channel: of 64 bits or fewer.
        records: (n, bytes).
        first: the number of the first record.

    Raises:
        MdfError: the channel does not lie within the records.
    """
    count, size = records.shape
    if channel.kind in (VIRTUAL, VIRTUAL_MASTER):
        return np.arange(first, first + count)
    width = (channel.bit_offset + channel.bit_count + 7) // 8
    if not 0 < width <= 8 or channel.byte_offset + width > size:
        raise MdfError(f"channel {channel.name} must lie within the {size} bytes of its records")
    is_big = channel.data_type in (UNSIGNED_BIG, SIGNED_BIG, FLOAT_BIG)
    kind = {FLOAT: "f", FLOAT_BIG: "f", SIGNED: "i", SIGNED_BIG: "i"}.get(channel.data_type, "u")
    if channel.data_type in TEXTS:
        return np.ndarray((count,), f"S{width}", records, channel.byte_offset, (size,))
    whole = channel.bit_offset == 0 and channel.bit_count in (8, 16, 32, 64)
    if whole and not (kind == "f" and width == 1):
        dtype = np.dtype(f"{'>' if is_big else '<'}{kind}{width}")
        return np.ndarray((count,), dtype, records, channel.byte_offset, (size,))
    word = np.zeros(count, np.uint64)
    places = range(width) if not is_big else range(width - 1, -1, -1)
    for shift, byte in enumerate(places):
        word |= records[:, channel.byte_offset + byte].astype(np.uint64) << np.uint64(8 * shift)
    return word >> np.uint64(channel.bit_offset) & np.uint64((1 << channel.bit_count) - 1)


def numbers(file: MdfFile, channel: Channel, records: UInt8s, first: int) -> NDArray[Any]:
    """(n,) whole physical values of 32 bits; words become 1 for "Tx" and the like, else 0.

    Raises:
        MdfError: see `physical`; or a value is not between 0 and 2**32 - 1.
    """
    values = physical(file, channel, records, first)
    if values.dtype.kind in "if":
        with np.errstate(invalid="ignore"):
            if not ((values >= 0) & (values <= _MOST_NUMBER)).all():
                raise MdfError(f"channel {channel.name} must be between 0 and {_MOST_NUMBER}")
    return values


def physical(file: MdfFile, channel: Channel, records: UInt8s, first: int) -> NDArray[Any]:
    """(n,) physical values; words become 1 for "Tx" and the like, else 0.

    Raises:
        MdfError: see `raw`; or asammdf cannot apply the conversion.
    """
    values = raw(channel, records, first)
    conversion = channel.conversion
    if conversion.kind == _ONE_TO_ONE:
        return values if values.dtype.kind != "S" else np.isin(values.astype(str), _YES)
    if conversion.kind == _LINEAR and len(conversion.values) >= 2:
        offset, factor = conversion.values[:2]
        return values if (offset, factor) == (0, 1) else offset + factor * values
    if conversion.kind == _NEAREST and len(conversion.values) >= 2:
        return _nearest(conversion, values)
    if conversion.kind in (_VALUE_TO_TEXT, _RANGE_TO_TEXT) and not conversion.is_nested:
        if channel.kind != VIRTUAL:
            return values  # codes: 1 for Tx, whatever the words
        return np.array([_says_yes(conversion, float(value)) for value in values], np.uint8)
    found = _by_asammdf(file, channel, values)
    if found.dtype.kind in "iufb":
        return found
    is_code = values.dtype.kind != "S" and channel.kind != VIRTUAL
    numbered = [
        said if not isinstance(said, bytes) else code if is_code else said.decode() in _YES
        for said, code in zip(found.tolist(), values.tolist(), strict=True)
    ]
    return np.array(numbered, np.float64)


def _nearest(conversion: Conversion, values: NDArray[Any]) -> NDArray[np.float64]:
    """A table without interpolation: what belongs to the nearest key, the lower of two."""
    table = np.array(conversion.values[: len(conversion.values) // 2 * 2]).reshape(-1, 2)
    keys = table[:, 0]
    above = np.minimum(np.searchsorted(keys, values), len(keys) - 1)
    below = np.maximum(above - 1, 0)
    is_lower = np.abs(values - keys[above]) >= np.abs(values - keys[below])
    found: NDArray[np.float64] = table[np.where(is_lower, below, above), 1]
    return found


def _by_asammdf(file: MdfFile, channel: Channel, values: NDArray[Any]) -> NDArray[Any]:
    """Raw values converted by asammdf, for conversions that loggers rarely use."""
    conversion = channel.conversion
    if conversion.kind == _FORMULA and not _ARITHMETIC.fullmatch("".join(conversion.words)):
        raise MdfError(f"channel {channel.name} has a formula that is not read: {conversion.words}")
    from asammdf.blocks.v4_blocks import ChannelConversion  # noqa: PLC0415 (slow to import)

    try:
        block = ChannelConversion(
            stream=file.file, address=conversion.at, mapped=False, file_limit=file.size
        )
        return np.asarray(block.convert(values, as_object=True))
    except Exception as error:  # whatever a damaged block leads to
        raise MdfError(
            f"channel {channel.name} has a conversion of type {conversion.kind} that asammdf does "
            f"not apply: {one_line(error)}"
        ) from None


def _says_yes(conversion: Conversion, value: float) -> bool:
    step = 1 if conversion.kind == _VALUE_TO_TEXT else 2
    lows, highs = conversion.values[::step], conversion.values[step - 1 :: step]
    pairs = enumerate(zip(lows, highs, strict=False))
    at = next((i for i, (low, high) in pairs if low <= value <= high), len(lows))
    return at < len(conversion.words) and conversion.words[at] in _YES


def time_ns(file: MdfFile, channel: Channel, records: UInt8s, first: int) -> NDArray[np.int64]:
    """(n,) time stamps since the start of the recording, to the nearest nanosecond.

    Raises:
        MdfError: see `physical`; or a time stamp exceeds 146 years.
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
        times = physical(file, channel, records, first).astype(np.float64)
        stamps = np.round(times * _NS_PER_S)
    if not (np.abs(stamps) < 1 << 62).all():
        raise MdfError("a time stamp that is no number, or later than 146 years after the start")
    return stamps.astype(np.int64)


def payloads(channel: Channel, records: UInt8s, length: UInt8s) -> UInt8s:
    """(n, 8) or (n, 64) bytes of a channel of fixed size; zero behind the lengths.

    Raises:
        MdfError: the channel does not lie within the records.
    """
    width = channel.elements if channel.elements > 1 else channel.bit_count // 8
    if channel.byte_offset + width > records.shape[1]:
        raise MdfError(f"channel {channel.name} must lie within the bytes of its records")
    rows = empty_rows(length)
    copy_fixed(records, channel.byte_offset, width, length, rows)
    return rows


@compiled
def copy_fixed(records: UInt8s, at: int, width: int, length: UInt8s, rows: UInt8s) -> None:
    """Fill ``rows`` with the payload bytes of each record, up to the record's end."""
    for row in range(len(rows)):
        size = min(width, np.int64(length[row]), rows.shape[1])
        for byte in range(size):
            rows[row, byte] = records[row, at + byte]
        for byte in range(size, rows.shape[1]):
            rows[row, byte] = 0
