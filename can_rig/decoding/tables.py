"""Decoded messages as tables in files: CSV and Parquet, written piece by piece with pyarrow.

In a folder each message has a table of its own, with a column for each signal. A single table of
all messages exists only as CSV (`WideCsv`): in Parquet an empty cell takes time and memory too.

Time is exact, in ``time_s``. Only a date in Parquet is ``time``, a time stamp in UTC to the
nanosecond: PlotJuggler takes it for seconds, pandas for a date. CSV has nine decimal places.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from can_rig.decoding.files import INDEX, Contents
from can_rig.decoding.message_decoder import MessageColumns
from can_rig.logs.frames import NS_PER_S
from can_rig.storage.files import FileNames

TIME_S: Final = "time_s"
_TYPES: Final = {"i": pa.int64(), "u": pa.uint64(), "f": pa.float64(), "O": pa.string()}
_DATE: Final = pa.decimal128(28, 9)  # [s]
_STAMP: Final = pa.timestamp("ns", tz="UTC")
_EXACT_NS: Final = 1 << 53  # up to here (104 days) float64 seconds tell every nanosecond
_CELLS: Final = 1 << 23  # held in memory, for long row groups even with 1,000 messages
_COMMAS: Final = 1 << 24  # bytes in memory


class FolderOfTables:
    """A file for each message that occurs, and an index of the files.

    Args:
        folder: the folder of the files; its suffix, or else ``.csv``, is that of the files.
        contents: of the log.
    """

    def __init__(self, folder: Path, contents: Contents) -> None:
        self._folder = folder
        self._file_names = FileNames()
        self._file_names.of(INDEX)
        self._messages: dict[str, str] = {}  # by file name
        self._suffix = folder.suffix or ".csv"
        self._contents = contents
        self._tables: dict[str, _Table] = {}

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk."""
        names = self._contents.names
        for name, columns in chunk.items():
            if name not in self._tables:
                fields = _signal_types(columns, names)
                file = self._file_names.of(name, self._suffix)
                self._messages[file] = name
                path = self._folder / file
                self._tables[name] = _Table(path, name, fields, self._contents.start_ns)
            cells = [_signal_cells(columns, signal, names) for signal in columns.signals]
            self._tables[name].add(columns.time_ns, cells)
        held = sum(table.cells for table in self._tables.values())
        for table in sorted(self._tables.values(), key=lambda table: -table.cells):
            if held <= _CELLS:
                break
            held -= table.cells
            table.flush()

    def close(self) -> None:
        """Finish the files."""
        for table in self._tables.values():
            table.close()
        text = json.dumps({"files": self._messages}, indent=2)
        (self._folder / INDEX).write_text(text + "\n", encoding="utf-8")


def write_table(path: Path, columns: MessageColumns, start_ns: int) -> None:
    """Write one message into one ``.csv`` or ``.parquet``; ``start_ns``: see `Contents`."""
    table = _Table(path, columns.name, _signal_types(columns, False), start_ns)
    table.add(columns.time_ns, [_signal_cells(columns, name, False) for name in columns.signals])
    table.close()


class _Table:
    """The file of one message, with the time and ``fields`` (signal → type) as columns."""

    def __init__(self, path: Path, message: str, fields: Mapping[str, Any], start_ns: int) -> None:
        is_csv = path.suffix == ".csv"
        self._times, time = _time_column(is_csv, start_ns)
        # A signal with the name of the time column has its message's before it.
        names = [f"{message}.{signal}" if signal == time[0] else signal for signal in fields]
        self._schema = pa.schema([time, *zip(names, fields.values(), strict=True)])
        self._writer: Any = (
            pyarrow.csv.CSVWriter(path, self._schema)
            if is_csv  # a relative path with a colon is a URI to pyarrow
            else pyarrow.parquet.ParquetWriter(path.absolute(), self._schema, compression="zstd")
        )
        self._held: list[Any] = []
        self.cells = 0
        """Number of cells in memory."""

    def add(self, time_ns: NDArray[np.int64], cells: list[Any]) -> None:
        """Add rows, which are held in memory until `flush`."""
        self._held.append(pa.table([self._times(time_ns), *cells], schema=self._schema))
        self.cells += len(time_ns) * len(self._schema)

    def flush(self) -> None:
        """Write the rows in memory: in Parquet, a row group."""
        if self._held:
            self._writer.write_table(pa.concat_tables(self._held))
        self._held, self.cells = [], 0

    def close(self) -> None:
        """Write the rest, and finish the file."""
        self.flush()
        self._writer.close()


def _time_column(
    is_csv: bool, start_ns: int
) -> tuple[Callable[[NDArray[np.int64]], Any], tuple[str, Any]]:
    """A function from (n,) times [ns] to cells, and name and type of the column."""
    if start_ns < _EXACT_NS:
        return _seconds, (TIME_S, pa.float64())
    return (_decimals, (TIME_S, _DATE)) if is_csv else (_stamps, ("time", _STAMP))


def _stamps(time_ns: NDArray[np.int64]) -> Any:
    return pa.array(time_ns, pa.int64()).cast(_STAMP)


def _seconds(time_ns: NDArray[np.int64]) -> Any:
    return pa.array(time_ns / NS_PER_S)


def _decimals(time_ns: NDArray[np.int64]) -> Any:
    """Nanoseconds as decimals of a second: 16 bytes each, in two's complement."""
    wide = np.stack([time_ns, time_ns >> 63], axis=1)
    return pa.Array.from_buffers(_DATE, len(time_ns), [None, pa.py_buffer(wide.tobytes())])


def _signal_types(columns: MessageColumns, names: bool) -> dict[str, Any]:
    """The type of each signal's column."""
    return {
        signal: pa.string()
        if names and columns.layout[signal].is_enumeration
        else _TYPES[values.dtype.kind]
        for signal, values in columns.signals.items()
    }


def _signal_cells(columns: MessageColumns, signal: str, names: bool) -> Any:
    """(n,) cells of a signal, null where a frame does not have it."""
    column = columns.signals[signal]
    values = np.ma.getdata(column)
    mask = np.ma.getmaskarray(column) if isinstance(column, np.ma.MaskedArray) else None
    if names and columns.layout[signal].is_enumeration:
        words = columns.words(signal)
        bare = np.array([word is None for word in words], dtype=bool)  # numbers without a word
        words[bare] = values[bare].astype(str)
        return pa.array(words, pa.string(), mask=mask)
    if values.dtype == object:
        values = np.array([str(value) for value in values.tolist()], dtype=object)
    return pa.array(values, _TYPES[values.dtype.kind], mask=mask)


class WideCsv:
    """A single table of all messages: a row for each frame, in the order of the log.

    A row has the name of its message, and a column ``Message.Signal`` for each signal of the log.
    The columns of other messages are empty, so a row is the text of its own cells between two runs
    of commas. Only the number of commas grows with the number of columns.
    """

    def __init__(self, path: Path, contents: Contents) -> None:
        layout = contents.layout
        self._names = contents.names
        self._times, (time, _) = _time_column(True, contents.start_ns)
        fields = [f"{name}.{signal}" for name, one in layout.items() for signal in one.signals]
        self._width: Final = len(fields)
        self._around: dict[str, tuple[str, str]] = {}
        before = 0
        for name, columns in layout.items():
            own = len(columns.signals)
            after = self._width - before - own
            commas = "," * (before + bool(own))
            self._around[name] = f",{_quoted(name)}{commas}", f"{',' * after}\n"
            before += own
        self._file = path.open("wb")
        self._file.write((",".join(map(_quoted, [time, "message", *fields])) + "\n").encode())

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk, with their frames in the order of the log."""
        if not chunk:
            return
        every = list(chunk.values())
        order = np.argsort(np.concatenate([columns.row for columns in every]))
        time_ns = np.concatenate([columns.time_ns for columns in every])[order]
        times = self._times(time_ns).cast(pa.string())
        which = np.repeat(np.arange(len(every)), [len(columns) for columns in every])[order]
        cells = pa.concat_arrays([self._cells(columns) for columns in every]).take(pa.array(order))
        before, after = (pa.array([self._around[name][at] for name in chunk]) for at in (0, 1))
        rows = max(_COMMAS // (self._width + 1), 1)
        for begin in range(0, len(order), rows):
            part = slice(begin, begin + rows)
            of = pa.array(which[part])
            lines = pc.binary_join_element_wise(
                times[part], before.take(of), cells[part], after.take(of), ""
            )
            _, ends, text = lines.buffers()
            self._file.write(text[: np.frombuffer(ends, np.int32)[len(lines)]])

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def _cells(self, columns: MessageColumns) -> Any:
        """(n,) the text of a message's own cells, with commas between them."""
        cells = []
        for signal in columns.signals:
            column = _signal_cells(columns, signal, self._names)
            text = column.cast(pa.string())
            cells.append(_quoted_cells(text) if column.type == pa.string() else text)
        if not cells:
            return pa.array([""] * len(columns), pa.string())
        return pc.binary_join_element_wise(*cells, ",", null_handling="replace")


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


def _quoted_cells(texts: Any) -> Any:
    """(n,) `_quoted` of each text, null for a missing text."""
    doubled = pc.replace_substring(texts, '"', '""')
    return pc.binary_join_element_wise('"', doubled, '"', "")
