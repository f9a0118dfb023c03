"""Decodes all frames of a DBC message at once into columns, and counts frames without a row.

A message has a row for each frame, a column for each signal: bits → raw values → physical values.
Every value equals that of cantools for the same frame, to the bit: the same order of operations
(raw · factor + offset), and integers where cantools has integers, of any length.

| raw              | factor and offset        | column                                      |
|------------------|--------------------------|---------------------------------------------|
| integer          | both whole               | int64; uint64, then int in `object` if long |
| integer or float | anything else            | float64                                     |
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from cantools.database.can import Message as DbcMessage, Signal
from cantools.database.conversion import BaseConversion, LinearIntegerConversion
from numpy.typing import NDArray

from can_rig.errors import DbcError
from can_rig.frames.codec import COUNTERS, FRAME_BYTES, ROLES, SPEED
from can_rig.frames.databases import attribute
from can_rig.frames.frame_columns import crcs
from can_rig.logs.frames import CLASSIC_BYTES, NS_PER_S, REMOTE, Frames, UInt8s
from can_rig.storage import paged

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class MessageColumns:
    """The decoded frames of one message, in the order of the log."""

    name: str
    time_ns: NDArray[np.int64]
    """(n,) time stamps as in `Frames.time_ns` [ns]."""
    row: NDArray[np.int64]
    """(n,) number of the frame in the log, from 0."""
    signals: dict[str, Column]
    """(n,) physical values by signal name, in the order of the database; a numpy masked array for a
    signal that is not in every frame: multiplexed signals, and signals beyond the end of short
    frames."""
    codes: dict[str, Column]
    """(n,) raw values of the signals with a value table."""
    layout: Mapping[str, SignalColumn] = field(repr=False)
    """Unit, value table and place of each signal."""

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(n,) time stamps [s]; float64 resolves 0.2 µs of a date, and ns of the first 50 days."""
        return self.time_ns / NS_PER_S

    def words(self, signal: str) -> NDArray[np.object_]:
        """(n,) words of a signal's value table; None: no word, or no signal."""
        words = self.layout[signal].words(np.ma.getdata(self.codes[signal]))
        words[np.ma.getmaskarray(self.codes[signal])] = None
        return words

    def to_pandas(self) -> pd.DataFrame:
        """A row for each frame, a column for each signal; the index is ``time_s``.

        A signal that is not in a frame is NaN, or <NA> in a column of integers.
        """
        import pandas as pd  # noqa: PLC0415 (slow to import)

        columns = {name: _series(column) for name, column in self.signals.items()}
        return pd.DataFrame(columns, index=pd.Index(self.time_s, name="time_s"))


def _series(column: Column) -> Any:
    import pandas as pd  # noqa: PLC0415

    if not isinstance(column, np.ma.MaskedArray):
        return column
    if column.dtype.kind == "f":
        return column.filled(np.nan)
    if column.dtype == object:
        return column.filled(None)
    return pd.arrays.IntegerArray(column.data, np.ma.getmaskarray(column))


_PAGED: Final = ({np.dtype(np.float64)}, {np.dtype(np.int64)})
"""Kinds of values that are in a file where there are many."""


def joined(parts: Sequence[MessageColumns]) -> MessageColumns:
    """Columns of the same message, concatenated; needs at least one part."""

    def together(columns: list[Column]) -> Column:
        masked = any(isinstance(column, np.ma.MaskedArray) for column in columns)
        kinds = {column.dtype for column in columns}
        if masked or kinds not in _PAGED:
            whole: Column = (np.ma if masked else np).concatenate(columns)
            return whole
        paged.let_go()
        out = paged.empty(sum(map(len, columns))).view(*kinds)
        return np.concatenate(columns, out=out)

    first = parts[0]
    return MessageColumns(
        first.name,
        together([part.time_ns for part in parts]),
        together([part.row for part in parts]),
        {name: together([part.signals[name] for part in parts]) for name in first.signals},
        {name: together([part.codes[name] for part in parts]) for name in first.codes},
        first.layout,
    )


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
        first_bit = self.first_bit
        if self.motorola:  # from behind it is Intel's
            data, first_bit = data[:, ::-1], data.shape[1] * 8 - first_bit - self.length
        if self.length > _WORD_BITS:
            return self._long(data, first_bit)
        word = self._bits(data, first_bit)
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

    def _bits(self, data: UInt8s, first_bit: int) -> NDArray[np.uint64]:
        """The signal in the low bits of words, whose other bits are not cleared."""
        byte, shift = divmod(first_bit, 8)
        word, begin = _window(data, byte, self.motorola)
        shift += (byte - begin) * 8
        word >>= np.uint64(shift)
        if shift + self.length > _WORD_BITS:  # its top bits are in a ninth byte
            word |= data[:, begin + _WORD_BYTES].astype(np.uint64) << np.uint64(_WORD_BITS - shift)
        return word

    def _long(self, data: UInt8s, first_bit: int) -> NDArray[np.object_]:
        """Decode signals of more than 64 bits, one value at a time."""
        mask, sign = (1 << self.length) - 1, 1 << self.length - 1
        values = np.empty(len(data), dtype=object)
        for row, payload in enumerate(data):
            bits = int.from_bytes(payload.tobytes(), "little") >> first_bit & mask
            values[row] = (bits ^ sign) - sign if self.is_signed else bits
        return values


def _window(data: UInt8s, byte: int, backwards: bool) -> tuple[NDArray[np.uint64], int]:
    """Eight bytes of every payload as one word, and their first byte: ``byte`` or the previous."""
    begin = max(min(byte, data.shape[1] - _WORD_BYTES), 0)
    eight = data[:, begin : begin + _WORD_BYTES]
    if eight.shape[1] < _WORD_BYTES:
        eight = np.pad(eight, ((0, 0), (0, _WORD_BYTES - eight.shape[1])))
    if backwards:  # in memory as the frame has them: no copy
        return np.ascontiguousarray(eight[:, ::-1]).view(">u8")[:, 0].astype(np.uint64), begin
    return np.ascontiguousarray(eight).view("<u8")[:, 0].astype(np.uint64), begin


def byte_column(name: str) -> SignalColumn:
    """The column of an unsigned number of 8 bits, without a unit."""
    conversion = BaseConversion.factory(scale=1, offset=0)
    return SignalColumn(name, "", 0, 8, False, False, False, conversion, {})


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


COUNTER_BITS: Final = 0x0F

Rows = NDArray[np.bool_]


@dataclass
class Counts:
    """Outcome of the frames of one message.

    ``frames`` is the sum of ``decoded`` and of the five reasons after it.
    """

    frames: int = 0
    decoded: int = 0
    """Frames with a row."""
    too_short: int = 0
    """No signal fits into so few bytes; with E2E, any other number than in the database."""
    remote: int = 0
    """Remote frames (no payload)."""
    unknown_multiplexer: int = 0
    """The multiplexer has a value for which the database has no signals."""
    wrong_crc: int = 0
    """E2E: damaged, from a wrong sender, or with the invalid counter 15."""
    repeated: int = 0
    """E2E: the same counter as the frame before; 15 lost frames look the same."""
    shorter: int = 0
    """Decoded, but shorter than in the database: signals beyond the end are missing."""
    longer: int = 0
    """Decoded, but with more bytes than in the database."""
    gaps: int = 0
    """E2E: decoded, but the counter shows missing frames."""
    lost: int = 0
    """E2E: number of missing frames in all gaps; the true number may exceed the count by a multiple
    of 15."""

    def as_dict(self) -> dict[str, int]:
        """Every count, by name."""
        return asdict(self)


class MessageDecoder:
    """Decodes the frames of one message, chunk after chunk.

    Args:
        message: from any cantools database.
        wanted: the signals to decode; None: all.
        name: name of the message in the result; None: as in the database.

    Raises:
        DbcError: a signal is a float of an odd length.
    """

    def __init__(
        self, message: DbcMessage, wanted: Collection[str] | None = None, name: str | None = None
    ) -> None:
        self.message = message
        self.counts = Counts()
        self._name = name or message.name
        where = f"message {self._name}"
        columns = [signal_column(signal, where) for signal in message.signals]
        inside = [
            c
            for c in columns
            if c.first_bit >= 0 < c.length and c.first_bit + c.length <= 8 * message.length
        ]
        self._layout = {column.name: column for column in inside}
        self._wanted = [name for name in self._layout if wanted is None or name in wanted]
        outside = [signal for signal in message.signals if signal.name not in self._layout]
        self._tree = message.signal_tree
        if any(signal.is_multiplexer for signal in outside):
            outside, self._wanted, self._tree = message.signals, [], []
        self.left_out = [f"{self._name}.{signal.name}" for signal in outside]
        """Signals outside the message, or with a multiplexer outside."""
        # The signals in every frame: those at the root of the tree, including multiplexers.
        self._always = {n if isinstance(n, str) else next(iter(n)) for n in self._tree}
        self._data_id = protected_by(message)
        self._counter: int | None = None

    @property
    def signals(self) -> list[str]:
        """Names of the decoded signals."""
        return self._wanted

    def decode(self, frames: Frames, row: NDArray[np.int64]) -> MessageColumns:
        """The columns of the usable ``frames``; all ``frames`` have the message's identifier."""
        self.counts.frames += len(frames)
        usable = self._usable(frames)
        if not usable.all():
            frames, row = frames[usable], row[usable]
        data = _at_least(frames.data, max(self.message.length, CLASSIC_BYTES))
        present: dict[str, Rows] = {}
        short = frames.length < self.message.length
        bits = 8 * frames.length.astype(np.int64) if short.any() else None
        known = self._find(self._tree, data, bits, np.ones(len(frames), bool), present)
        self.counts.unknown_multiplexer += int((~known).sum())
        if bits is not None:
            empty = short & known & ~np.any([*present.values(), ~short], axis=0)
            self.counts.too_short += int(empty.sum())
            known &= ~empty
        if not known.all():
            frames, row, data, short = frames[known], row[known], data[known], short[known]
            present = {name: mask[known] for name, mask in present.items()}
        self.counts.decoded += len(frames)
        self.counts.shorter += int(short.sum())
        self.counts.longer += int((frames.length > self.message.length).sum())
        signals, codes = {}, {}
        for name in self._wanted:
            there = present.get(
                name, np.zeros(len(frames), bool)
            )  # absent for every multiplexer's value
            raw, signals[name] = self._column(name, data, there)
            if self._layout[name].choices:
                codes[name] = raw
        layout = {name: self._layout[name] for name in self._wanted}
        return MessageColumns(self._name, frames.time_ns, row, signals, codes, layout)

    def _usable(self, frames: Frames) -> Rows:
        """(n,) whether a frame has a payload and, if protected, is intact and not repeated."""
        counts = self.counts
        remote = frames.has(REMOTE)
        counts.remote += int(remote.sum())
        if self._data_id is None:
            return ~remote
        short = ~remote & (frames.length != self.message.length)
        counts.too_short += int(short.sum())
        whole = ~remote & ~short
        usable: Rows = whole & intact_rows(frames.data, frames.length, self._data_id)
        counts.wrong_crc += int(whole.sum() - usable.sum())
        counter = counters(frames.data)[usable]
        ahead = steps(counter, self._counter)
        counts.repeated += int((ahead == 0).sum())
        counts.gaps += int((ahead > 1).sum())
        counts.lost += int((ahead[ahead > 1] - 1).sum())
        if len(counter):
            self._counter = int(counter[-1])
        usable[usable] = ahead != 0
        return usable

    def _find(
        self,
        tree: Sequence[Any],
        data: UInt8s,
        bits: NDArray[np.int64] | None,
        rows: Rows,
        present: dict[str, Rows],
    ) -> Rows:
        """Set ``present`` for the ``rows`` that contain each signal of ``tree``.

        Args:
            tree: signals, and signals below values of a multiplexer.
            data: (n, bytes) payloads.
            bits: (n,) lengths of the payloads; None: every signal fits.
            rows: (n,) the frames to look at.
            present: gets (n,) for each signal.

        Returns (n,) whether every multiplexer has a value known to the database.
        """
        known, nowhere = np.ones(len(rows), dtype=bool), np.zeros(len(rows), dtype=bool)
        for node in tree:
            name, branches = (node, None) if isinstance(node, str) else next(iter(node.items()))
            column = self._layout.get(name)
            if column is None:  # the signal exceeds the message
                continue
            here = rows if bits is None else rows & (bits >= column.first_bit + column.length)
            present[name] = present.get(name, nowhere) | here
            if branches is None:
                continue
            number = column.physical(column.raw(data))  # as in cantools: scaled, then truncated
            number = np.trunc(number) if number.dtype.kind == "f" else number
            for value in np.unique(number[here]).tolist():
                chosen = here & (number == value)
                if value in branches:
                    known &= self._find(branches[value], data, bits, chosen, present)
                else:
                    known &= ~chosen
        return known

    def _column(self, name: str, data: UInt8s, rows: Rows) -> tuple[Column, Column]:
        """Raw and physical values; masked arrays for a multiplexed signal."""
        column = self._layout[name]
        if name in self._always and rows.all():
            raw = column.raw(data)
            return raw, column.physical(raw)
        raw = column.raw(data[rows])
        return _spread(raw, rows), _spread(column.physical(raw), rows)


def _spread(values: Column, rows: Rows) -> Column:
    whole = np.zeros(len(rows), dtype=values.dtype)
    whole[rows] = values
    return np.ma.MaskedArray(whole, mask=~rows)


def _at_least(data: UInt8s, width: int) -> UInt8s:
    missing = width - data.shape[1]
    return np.pad(data, ((0, 0), (0, missing))) if missing > 0 else data


def protected_by(message: DbcMessage) -> int | None:
    """The E2E data identifier of a message of the rig; None for foreign messages."""
    data_id = attribute(message, "E2EDataId")
    if attribute(message, "RigRole") not in (*ROLES, SPEED) or not isinstance(data_id, int):
        return None
    return data_id if 0 < data_id <= 0xFFFF and message.length == CLASSIC_BYTES else None


# The check of AUTOSAR E2E profile 1 for many frames at once: a vectorised `codec.Checker`.


def intact_rows(data: UInt8s, length: UInt8s, data_id: int) -> Rows:
    """(n,) result of e2e_p01_check for payloads (n, 8 or more) of these lengths."""
    whole: Rows = crcs(data, data_id) == data[:, 0]
    whole &= counters(data) < COUNTERS
    whole &= length == FRAME_BYTES
    return whole


def counters(data: UInt8s) -> UInt8s:
    """(n,) alive counters of payloads."""
    return data[:, 1] & np.uint8(COUNTER_BITS)


def steps(counter: UInt8s, before: int | None) -> NDArray[np.int64]:
    """(n,) increments of the counter, 0..14; 1 is in sequence.

    Args:
        counter: (n,) of intact frames, in their order.
        before: the last preceding counter; None: the first frame starts the sequence.
    """
    numbers = counter.astype(np.int64)
    first = (numbers[:1] - 1) if before is None else np.array([before])
    ahead: NDArray[np.int64] = np.diff(numbers, prepend=first[: len(numbers)]) % COUNTERS
    return ahead
