"""Decoded messages as tables in files: CSV and Parquet, written chunk by chunk with pyarrow.

One table holds every message: a row for each frame, in the order of the log, with the name of its
message, and a column for each signal, empty where it is not in the frame: ``Message.Signal`` in
CSV, ``Message/Signal`` in Parquet, of which PlotJuggler makes a tree. In a folder each message has
a file of its own, with its signals as columns.

Time is exact, in ``time_s``. Only a date in Parquet is ``time``, a time stamp in UTC to the
nanosecond: PlotJuggler takes it for seconds, pandas for a date. In CSV it has nine decimal places.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from can_rig.decoding.message_columns import MessageColumns
from can_rig.files import FileNames
from can_rig.logs.frames import NS_PER_S

_TYPES: Final = {"i": pa.int64(), "u": pa.uint64(), "f": pa.float64(), "O": pa.string()}
_DATE: Final = pa.decimal128(28, 9)  # [s]
_STAMP: Final = pa.timestamp("ns", tz="UTC")
_EXACT_NS: Final = 1 << 53  # up to here (104 days) float64 seconds tell every nanosecond


class WideTable:
    """One table of all messages.

    Args:
        path: ``.csv``, or ``.parquet``.
        layout: for every message that can occur, its columns without rows.
        start_ns: time of about the first frame [ns].
        names: whether to write words of value tables instead of codes.
    """

    def __init__(
        self, path: Path, layout: Mapping[str, MessageColumns], start_ns: int, names: bool
    ) -> None:
        self._names = names
        self._is_csv = path.suffix == ".csv"
        self._fields = {
            self._field(message, signal): kind
            for message, columns in layout.items()
            for signal, kind in _fields(columns, names).items()
        }
        self._table = _Table(path, {"message": pa.string(), **self._fields}, start_ns)

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk, with their frames in the order of the log."""
        if not chunk:
            return
        order = np.argsort(np.concatenate([columns.row for columns in chunk.values()]))
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        time_ns = np.concatenate([columns.time_ns for columns in chunk.values()])[order]
        sizes = [len(columns) for columns in chunk.values()]
        which = pa.array(np.repeat(np.arange(len(chunk)), sizes)[order], pa.int32())
        message = pa.DictionaryArray.from_arrays(which, pa.array(list(chunk), pa.string()))
        cells = {"message": message.cast(pa.string())}
        for (name, columns), rows in zip(
            chunk.items(), np.split(place, np.cumsum(sizes)[:-1]), strict=True
        ):
            for signal in columns.signals:
                values, missing = _values(columns, signal, self._names)
                spread = np.zeros(len(order), dtype=values.dtype)
                nothing = np.ones(len(order), dtype=bool)
                spread[rows], nothing[rows] = values, missing
                field = self._field(name, signal)
                cells[field] = pa.array(spread, self._fields[field], mask=nothing)
        for field, kind in self._fields.items():
            cells.setdefault(field, pa.nulls(len(order), kind))
        self._table.write(time_ns, cells)

    def close(self) -> None:
        """Finish the file."""
        self._table.close()

    def _field(self, message: str, signal: str) -> str:
        return f"{message}.{signal}" if self._is_csv else f"{message}.{signal}".replace(".", "/")


class FolderOfTables:
    """A CSV file for each message that occurs, and an index; arguments as those of `WideTable`.

    Args:
        index: name of the JSON file that says which file has which message.
    """

    def __init__(self, folder: Path, start_ns: int, names: bool, index: str) -> None:
        self._folder = folder
        self._index = folder / index
        self._file_names = FileNames()
        self._file_names.of(index)
        self._messages: dict[str, str] = {}  # by file name
        self._start_ns = start_ns
        self._names = names
        self._tables: dict[str, _Table] = {}

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk."""
        for name, columns in chunk.items():
            fields = _fields(columns, self._names)
            if name not in self._tables:
                file = self._file_names.of(name, ".csv")
                self._messages[file] = name
                self._tables[name] = _Table(self._folder / file, fields, self._start_ns)
            cells = {}
            for signal, kind in fields.items():
                values, missing = _values(columns, signal, self._names)
                cells[signal] = pa.array(values, kind, mask=missing)
            self._tables[name].write(columns.time_ns, cells)

    def close(self) -> None:
        """Finish the files."""
        for table in self._tables.values():
            table.close()
        text = json.dumps({"files": self._messages}, indent=2)
        self._index.write_text(text + "\n", encoding="utf-8")


class _Table:
    """One file, with the time and ``fields`` (name → type) as columns."""

    def __init__(self, path: Path, fields: Mapping[str, Any], start_ns: int) -> None:
        is_csv = path.suffix == ".csv"
        self._time: Callable[[NDArray[np.int64]], Any] = _seconds
        time = ("time_s", pa.float64())
        if start_ns >= _EXACT_NS:
            self._time, time = (
                (_decimals, ("time_s", _DATE)) if is_csv else (_stamps, ("time", _STAMP))
            )
        self._schema = pa.schema([time, *fields.items()])
        self._writer: Any = (
            pyarrow.csv.CSVWriter(path, self._schema)
            if is_csv
            else pyarrow.parquet.ParquetWriter(path, self._schema, compression="zstd")
        )

    def write(self, time_ns: NDArray[np.int64], cells: Mapping[str, Any]) -> None:
        """Add rows."""
        columns = [self._time(time_ns), *(cells[name] for name in self._schema.names[1:])]
        self._writer.write_table(pa.table(columns, schema=self._schema))

    def close(self) -> None:
        """Write what is still held in memory."""
        self._writer.close()


def _stamps(time_ns: NDArray[np.int64]) -> Any:
    return pa.array(time_ns, pa.int64()).cast(_STAMP)


def _seconds(time_ns: NDArray[np.int64]) -> Any:
    return pa.array(time_ns / NS_PER_S)


def _decimals(time_ns: NDArray[np.int64]) -> Any:
    """Nanoseconds as decimals of a second: 16 bytes each, in two's complement."""
    wide = np.stack([time_ns, time_ns >> 63], axis=1)
    return pa.Array.from_buffers(_DATE, len(time_ns), [None, pa.py_buffer(wide.tobytes())])


def _fields(columns: MessageColumns, names: bool) -> dict[str, Any]:
    """The type of each signal's column."""
    return {
        signal: pa.string()
        if names and columns.layout[signal].is_enumeration
        else _TYPES[values.dtype.kind]
        for signal, values in columns.signals.items()
    }


def _values(
    columns: MessageColumns, signal: str, names: bool
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """(n,) values to write, and where there is none."""
    values = np.ma.getdata(columns.signals[signal])
    missing = np.ma.getmaskarray(columns.signals[signal])
    if names and columns.layout[signal].is_enumeration:
        words = columns.words(signal)
        bare = np.array([word is None for word in words])  # numbers without a word
        words[bare] = values[bare].astype(str)
        return words, missing
    if values.dtype == object:
        values = np.array([str(value) for value in values.tolist()], dtype=object)
    return values, missing
