"""The decoded frames of one message as columns: a row for each frame, a column for each signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig import paged
from can_rig.decoding.signal_columns import Column, SignalColumn
from can_rig.logs.frames import NS_PER_S

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
