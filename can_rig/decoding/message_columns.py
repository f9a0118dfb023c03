"""One message of a DBC: all its frames at once → one column a signal, and what was wrong."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from cantools.database.can import Message as DbcMessage
from numpy.typing import NDArray

from can_rig.decoding import e2e_columns
from can_rig.decoding.signal_columns import Column, SignalColumn, signal_column
from can_rig.errors import DbcError
from can_rig.frames import layout as frame_layout
from can_rig.frames.layout import ROLES
from can_rig.logs.frames import CLASSIC_BYTES, NS_PER_S, REMOTE, Frames, UInt8s

if TYPE_CHECKING:
    import pandas as pd

Rows = NDArray[np.bool_]


@dataclass
class Counts:
    """What became of the frames of one message.

    ``decoded`` and the five reasons that follow it add up to ``frames``.
    """

    frames: int = 0
    decoded: int = 0
    """One row each."""
    too_short: int = 0
    """Fewer bytes than the DBC says; with E2E, any other number."""
    remote: int = 0
    """Remote frames: they have no payload."""
    unknown_multiplexer: int = 0
    """The multiplexer has a value for which the DBC has no signals."""
    wrong_crc: int = 0
    """E2E: damaged, another sender's, or the counter 15, which no sender uses."""
    repeated: int = 0
    """E2E: the counter of the frame before again; 15 lost frames look the same."""
    longer: int = 0
    """Decoded, from the first bytes; the DBC knows nothing of those behind."""
    gaps: int = 0
    """E2E: decoded, but the counter says that frames before it are missing."""
    lost: int = 0
    """E2E: so many frames are missing in all those gaps, or a multiple of 15 more."""

    def as_dict(self) -> dict[str, int]:
        """Every count by its name."""
        return asdict(self)


@dataclass(frozen=True)
class MessageColumns:
    """The decoded frames of one message, one a row, in the order of the log."""

    name: str
    time_ns: NDArray[np.int64]
    """(n,) time stamps, as `Frames.time_ns`."""
    row: NDArray[np.int64]
    """(n,) which frame of the log it was, from 0."""
    signals: dict[str, Column]
    """(n,) physical values by signal name, in the order of the DBC. A signal that is not in every
    frame, because it is multiplexed, is a numpy masked array."""
    codes: dict[str, Column]
    """(n,) raw values of the signals that have a value table."""
    layout: Mapping[str, SignalColumn] = field(repr=False)
    """Unit, value table and place of each signal."""

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """(n,) time stamps [s]; float64 resolves 0.2 µs of a date, and ns of the first 50 days."""
        return self.time_ns / NS_PER_S

    def words(self, signal: str) -> NDArray[np.object_]:
        """(n,) the words of a signal's value table; None where it has none, or is not there."""
        words = self.layout[signal].words(np.ma.getdata(self.codes[signal]))
        words[np.ma.getmaskarray(self.codes[signal])] = None
        return words

    def to_pandas(self) -> pd.DataFrame:
        """A row a frame, a column a signal, the index ``time_s``.

        What is not in a frame is NaN, or <NA> in a column of integers.
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


def joined(parts: Sequence[MessageColumns]) -> MessageColumns:
    """The columns of the same message behind one another; at least one part."""

    def together(columns: list[Column]) -> Column:
        masked = any(isinstance(column, np.ma.MaskedArray) for column in columns)
        whole: Column = (np.ma if masked else np).concatenate(columns)
        return whole

    first = parts[0]
    return MessageColumns(
        first.name,
        together([part.time_ns for part in parts]),
        together([part.row for part in parts]),
        {name: together([part.signals[name] for part in parts]) for name in first.signals},
        {name: together([part.codes[name] for part in parts]) for name in first.codes},
        first.layout,
    )


class MessageDecoder:
    """Decodes the frames of one message, chunk after chunk.

    Args:
        message: from any cantools database.
        wanted: the signals to decode; None: all.

    Raises:
        DbcError: a signal does not fit into the message, or is a float of an odd length.
    """

    def __init__(self, message: DbcMessage, wanted: Collection[str] | None = None) -> None:
        self.message = message
        self.counts = Counts()
        where = f"message {message.name}"
        self._layout = {s.name: signal_column(s, where) for s in message.signals}
        self._wanted = [name for name in self._layout if wanted is None or name in wanted]
        for column in self._layout.values():
            if column.first_bit + column.length > 8 * message.length:
                raise DbcError(
                    f"{where}: signal {column.name} ends behind its {message.length} bytes"
                )
        # The signals that every frame has: those at the root of the tree, multiplexers among them.
        self._always = {n if isinstance(n, str) else next(iter(n)) for n in message.signal_tree}
        self._data_id = protected_by(message)
        self._counter: int | None = None

    def decode(self, frames: Frames, row: NDArray[np.int64]) -> MessageColumns:
        """The columns of ``frames`` that can be used; all have this message's identifier."""
        self.counts.frames += len(frames)
        usable = self._usable(frames)
        if not usable.all():
            frames, row = frames[usable], row[usable]
        data = _at_least(frames.data, max(self.message.length, CLASSIC_BYTES))
        present: dict[str, Rows] = {}
        known = self._find(self.message.signal_tree, data, np.ones(len(frames), bool), present)
        if not known.all():
            frames, row, data = frames[known], row[known], data[known]
            present = {name: mask[known] for name, mask in present.items()}
            self.counts.unknown_multiplexer += int((~known).sum())
        self.counts.decoded += len(frames)
        self.counts.longer += int((frames.length > self.message.length).sum())
        signals, codes = {}, {}
        for name in self._wanted:
            raw, signals[name] = self._column(name, data, present[name])
            if self._layout[name].choices:
                codes[name] = raw
        layout = {name: self._layout[name] for name in self._wanted}
        return MessageColumns(self.message.name, frames.time_ns, row, signals, codes, layout)

    def _usable(self, frames: Frames) -> Rows:
        """(n,) whether a frame is long enough and, if it is protected, intact and new."""
        counts = self.counts
        remote = frames.has(REMOTE)
        counts.remote += int(remote.sum())
        if self._data_id is None:
            short = ~remote & (frames.length < self.message.length)
            counts.too_short += int(short.sum())
            enough: Rows = ~(remote | short)
            return enough
        short = ~remote & (frames.length != self.message.length)
        counts.too_short += int(short.sum())
        whole = ~remote & ~short
        usable: Rows = whole & e2e_columns.intact(frames.data, frames.length, self._data_id)
        counts.wrong_crc += int(whole.sum() - usable.sum())
        counter = e2e_columns.counters(frames.data[usable])
        steps = e2e_columns.steps(counter, self._counter)
        counts.repeated += int((steps == 0).sum())
        counts.gaps += int((steps > 1).sum())
        counts.lost += int((steps[steps > 1] - 1).sum())
        if len(counter):
            self._counter = int(counter[-1])
        usable[usable] = steps != 0
        return usable

    def _find(
        self, tree: Sequence[Any], data: UInt8s, rows: Rows, present: dict[str, Rows]
    ) -> Rows:
        """Note in ``present`` where each signal of ``tree`` is, of ``rows``.

        Returns (n,) where the values of the multiplexers are ones that the DBC has.
        """
        known, nowhere = np.ones(len(rows), dtype=bool), np.zeros(len(rows), dtype=bool)
        for node in tree:
            if isinstance(node, str):
                present[node] = present.get(node, nowhere) | rows
                continue
            ((name, branches),) = node.items()
            present[name] = present.get(name, nowhere) | rows
            column = self._layout[name]
            number = column.physical(column.raw(data))  # as cantools: scaled, without fraction
            number = np.trunc(number) if number.dtype.kind == "f" else number
            found = ~rows
            for value, branch in branches.items():
                chosen = rows & (number == value)
                found |= chosen
                known &= self._find(branch, data, chosen, present)
            known &= found
        return known

    def _column(self, name: str, data: UInt8s, rows: Rows) -> tuple[Column, Column]:
        """Raw and physical values; masked arrays if the signal is multiplexed."""
        column = self._layout[name]
        if name in self._always:
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
    """The E2E data identifier of a frame that is laid out as the rig's are; None of any other."""
    data_id = frame_layout.attribute(message, "E2EDataId")
    if frame_layout.attribute(message, "RigRole") not in ROLES or not isinstance(data_id, int):
        return None
    return data_id if 0 < data_id <= 0xFFFF and message.length == CLASSIC_BYTES else None
