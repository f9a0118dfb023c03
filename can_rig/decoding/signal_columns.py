"""One signal of a database, in many frames: bits → raw values → physical values.

Every value equals that of cantools for the same frame, to the bit: the same order of operations
(raw · factor + offset), and integers where cantools has integers, of any length.

| raw              | factor and offset        | column                                      |
|------------------|--------------------------|---------------------------------------------|
| integer          | both whole               | int64; uint64, then int in `object` if long |
| integer or float | anything else            | float64                                     |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from cantools.database.can import Signal
from cantools.database.conversion import BaseConversion, LinearIntegerConversion
from numpy.typing import NDArray

from can_rig.errors import DbcError
from can_rig.logs.frames import UInt8s

Column = NDArray[Any]

_WORD_BITS: Final = 64
_WORD_BYTES: Final = 8
_FLOATS: Final = {16: "2", 32: "4", 64: "8"}  # bits: bytes


@dataclass(frozen=True)
class SignalColumn:
    """Position of a signal in its frame, and meaning of the raw value."""

    name: str
    unit: str
    first_bit: int
    """Its first bit in its own byte order: Intel counts from the least significant bit of each
    byte, Motorola from the most significant."""
    length: int
    motorola: bool
    is_signed: bool
    is_float: bool
    conversion: BaseConversion
    """Factor and offset, without the value table."""
    choices: dict[int, str]
    """Value table: raw value → word."""

    @property
    def is_enumeration(self) -> bool:
        """Whether its numbers are codes, not physical values with a word for "not available"."""
        unscaled = self.conversion.scale == 1 and self.conversion.offset == 0
        return bool(self.choices) and unscaled and not self.is_float

    @property
    def value_table(self) -> str:
        """The value table in a line."""
        return ", ".join(f"{number} {word}" for number, word in sorted(self.choices.items()))

    def raw(self, data: UInt8s) -> Column:
        """(n,) raw values in payloads (n, bytes) that are long enough for the signal."""
        if self.length > _WORD_BITS:
            return self._long(data)
        word = self._motorola_bits(data) if self.motorola else self._intel_bits(data)
        if self.length < _WORD_BITS:
            word &= np.uint64((1 << self.length) - 1)
        if self.is_float:
            size = _FLOATS[self.length]
            with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
                return word.astype(f"u{size}").view(f"f{size}").astype(np.float64)
        if self.is_signed:
            signed = word.view(np.int64)
            if self.length < _WORD_BITS:
                sign = np.int64(1 << (self.length - 1))
                signed ^= sign
                signed -= sign
            return signed
        return word if self.length == _WORD_BITS else word.view(np.int64)

    def physical(self, raw: Column) -> Column:
        """(n,) physical values [``unit``] of raw ones."""
        with np.errstate(over="ignore", invalid="ignore"):  # inf and nan, as in Python's floats
            return self._physical(raw)

    def _physical(self, raw: Column) -> Column:
        scale, offset = self.conversion.scale, self.conversion.offset
        if self.is_float:
            if scale == 1 and offset == 0:
                return raw
            scaled: Column = raw * float(scale) + float(offset)
            return scaled
        if isinstance(self.conversion, LinearIntegerConversion) or (scale == 1 and offset == 0):
            return self._integer(raw, int(scale), int(offset))
        if isinstance(scale, int):  # the product is an exact integer; only the sum is rounded
            raw, scale = self._integer(raw, scale, 0), 1.0
        if raw.dtype == object:
            return np.array([value * scale + offset for value in raw.tolist()], dtype=np.float64)
        numbers: Column = raw.astype(np.float64) * scale + float(offset)
        return numbers

    def words(self, raw: Column) -> NDArray[np.object_]:
        """(n,) words of the value table; None for unlisted raw values."""
        get = self.choices.get
        return np.array([get(int(value)) for value in raw.tolist()], dtype=object)

    def _integer(self, raw: Column, scale: int, offset: int) -> Column:
        """raw · scale + offset in the shortest integers that hold every possible value."""
        if (scale, offset) == (1, 0):
            return raw
        low, high = (
            (-(1 << self.length - 1), (1 << self.length - 1) - 1)
            if self.is_signed
            else (0, (1 << self.length) - 1)
        )
        reached = [low, high, *(v * scale + o for v in (low, high) for o in (0, offset)), offset]
        for kind in (np.int64, np.uint64):
            span = np.iinfo(kind)
            if span.min <= min(reached) and max(reached) <= span.max and raw.dtype != object:
                exact: Column = raw.astype(kind) * kind(scale) + kind(offset)
                return exact
        return np.array([value * scale + offset for value in raw.tolist()], dtype=object)

    def _intel_bits(self, data: UInt8s) -> NDArray[np.uint64]:
        """The signal in the low bits of words, whose other bits are not cleared."""
        byte, shift = divmod(self.first_bit, 8)
        word, begin = _window(data, byte, "<u8")
        shift += (byte - begin) * 8
        word >>= np.uint64(shift)
        if shift + self.length > _WORD_BITS:  # its top bits are in a ninth byte
            word |= data[:, begin + _WORD_BYTES].astype(np.uint64) << np.uint64(_WORD_BITS - shift)
        return word

    def _motorola_bits(self, data: UInt8s) -> NDArray[np.uint64]:
        """The same for Motorola: the first byte of a frame is the most significant."""
        word, begin = _window(data, self.first_bit // 8, ">u8")
        behind = (begin + _WORD_BYTES) * 8 - (
            self.first_bit + self.length
        )  # bits after it in the window
        if behind >= 0:
            word >>= np.uint64(behind)
            return word
        word <<= np.uint64(-behind)  # its last bits are in a ninth byte
        word |= data[:, begin + _WORD_BYTES].astype(np.uint64) >> np.uint64(8 + behind)
        return word

    def _long(self, data: UInt8s) -> NDArray[np.object_]:
        """Decode signals of more than 64 bits, one value at a time."""
        size = data.shape[1]
        order = "big" if self.motorola else "little"
        behind = size * 8 - self.first_bit - self.length if self.motorola else self.first_bit
        mask, sign = (1 << self.length) - 1, 1 << self.length - 1
        values = np.empty(len(data), dtype=object)
        for row, payload in enumerate(data):
            bits = int.from_bytes(payload.tobytes(), order) >> behind & mask  # type: ignore[arg-type]
            values[row] = (bits ^ sign) - sign if self.is_signed else bits
        return values


def _window(data: UInt8s, byte: int, kind: str) -> tuple[NDArray[np.uint64], int]:
    """Eight bytes of every payload as one word, and their first byte: ``byte`` or the previous."""
    begin = max(min(byte, data.shape[1] - _WORD_BYTES), 0)
    eight = data[:, begin : begin + _WORD_BYTES]
    if eight.shape[1] < _WORD_BYTES:
        eight = np.pad(eight, ((0, 0), (0, _WORD_BYTES - eight.shape[1])))
    return np.ascontiguousarray(eight).view(kind)[:, 0].astype(np.uint64), begin


def unsigned_column(name: str, length: int) -> SignalColumn:
    """The column of an unsigned number without a unit."""
    conversion = BaseConversion.factory(scale=1, offset=0)
    return SignalColumn(name, "", 0, length, False, False, False, conversion, {})


def signal_column(signal: Signal, where: str) -> SignalColumn:
    """The column of a signal of the database.

    Raises:
        DbcError: a float is not of 16, 32 or 64 bits; ``where`` begins the line.
    """
    motorola = signal.byte_order == "big_endian"
    if signal.conversion.is_float and signal.length not in _FLOATS:
        raise DbcError(
            f"{where}: signal {signal.name} is a float of {signal.length} bits; "
            "it must have 16, 32 or 64"
        )
    start = signal.start
    return SignalColumn(
        name=signal.name,
        unit=signal.unit or "",
        first_bit=start // 8 * 8 + 7 - start % 8 if motorola else start,
        length=signal.length,
        motorola=motorola,
        is_signed=signal.is_signed,
        is_float=signal.conversion.is_float,
        conversion=BaseConversion.factory(
            scale=signal.conversion.scale,
            offset=signal.conversion.offset,
            is_float=signal.conversion.is_float,
        ),
        choices={int(raw): str(word) for raw, word in (signal.choices or {}).items()},
    )
