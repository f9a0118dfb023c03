"""A single CSV table of all messages: a row for each frame, in the order of the log.

A row has the name of its message, and a column ``Message.Signal`` for each signal of the log. The
columns of other messages are empty, so a row is the text of its own cells between two runs of
commas. Only the number of commas grows with the number of columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from can_rig.decoding.message_columns import MessageColumns
from can_rig.decoding.outputs.tables import signal_cells, time_column

_BYTES: Final = 1 << 24  # of commas in memory


class WideCsv:
    """Writes ``path`` chunk by chunk.

    Args:
        path: the file.
        layout: columns without rows, for every possible message.
        start_ns: time of about the first frame [ns].
        names: whether to write words of value tables instead of codes.
    """

    def __init__(
        self, path: Path, layout: Mapping[str, MessageColumns], start_ns: int, names: bool
    ) -> None:
        self._names = names
        self._times, (time, _) = time_column(True, start_ns)
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
        rows = max(_BYTES // (self._width + 1), 1)
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
            column = signal_cells(columns, signal, self._names)
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
