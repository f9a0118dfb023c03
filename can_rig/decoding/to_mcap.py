"""Decoded messages as MCAP: a channel for each message, JSON with a JSON schema.

Foxglove and PlotJuggler read both without a plugin; PlotJuggler skips channels without a schema.
Source: the MCAP specification, and its registry of encodings (`json`, `jsonschema`).
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from can_rig.decoding.files import Contents
from can_rig.decoding.message_decoder import MessageColumns
from can_rig.errors import LogError

_TYPES = {"i": "integer", "u": "integer", "f": "number", "O": "integer"}


class DecodedMcap:
    """Writes ``path`` chunk by chunk, in the order of the log.

    A message lacks multiplexed signals absent from the frame, and values unknown to JSON (infinite,
    or not a number).
    """

    def __init__(self, path: Path, contents: Contents) -> None:
        self._names = contents.names
        self._writer: Any = Writer(str(path))
        self._writer.start()
        self._channels: dict[str, int] = {}

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk.

        Raises:
            LogError: a time is before 1970; MCAP cannot express such times.
        """
        rows: list[tuple[int, int, int, str]] = []
        for name, columns in chunk.items():
            if len(columns) and int(columns.time_ns.min()) < 0:
                raise LogError(f"MCAP holds no times before 1970, and a frame of {name} has one")
            channel = self._channel(name, columns)
            times = zip(columns.row.tolist(), columns.time_ns.tolist(), strict=True)
            rows += [
                (row, channel, time_ns, text)
                for (row, time_ns), text in zip(times, _objects(columns, self._names), strict=True)
            ]
        for _, channel, time_ns, text in sorted(rows):
            self._writer.add_message(channel, time_ns, text.encode(), time_ns)

    def close(self) -> None:
        """Finish the file."""
        self._writer.finish()

    def _channel(self, name: str, columns: MessageColumns) -> int:
        if name not in self._channels:
            schema = json.dumps(_schema(name, columns, self._names)).encode()
            known = self._writer.register_schema(name, "jsonschema", schema)
            topic = name.replace(".", "/")
            self._channels[name] = self._writer.register_channel(topic, "json", known)
        return self._channels[name]


def _schema(name: str, columns: MessageColumns, names: bool) -> dict[str, Any]:
    properties = {}
    for signal, values in columns.signals.items():
        layout = columns.layout[signal]
        words = names and layout.is_enumeration
        about = {"type": "string" if words else _TYPES[values.dtype.kind]}
        if layout.unit or layout.value_table:
            about["description"] = "; ".join(filter(None, (layout.unit, layout.value_table)))
        properties[signal] = about
    return {"title": name, "type": "object", "properties": properties}


def _objects(columns: MessageColumns, names: bool) -> Iterator[str]:
    """Each row as a JSON object."""
    if not columns.signals:
        return iter(["{}"] * len(columns))
    cells = [_cells(columns, signal, names) for signal in columns.signals]
    return ("{" + ",".join(filter(None, row)) + "}" for row in zip(*cells, strict=True))


def _cells(columns: MessageColumns, signal: str, names: bool) -> list[str]:
    """``"Signal":value`` in each row; empty for missing values."""
    values = columns.signals[signal]
    missing: NDArray[np.bool_] = np.ma.getmaskarray(values)
    plain = np.ma.getdata(values)
    if plain.dtype.kind == "f":
        missing = missing | ~np.isfinite(plain)
    key = json.dumps(signal)
    texts = [f"{key}:{value!r}" for value in plain.tolist()]
    if names and columns.layout[signal].is_enumeration:
        words = columns.words(signal).tolist()
        texts = [
            f"{key}:{json.dumps(str(value) if word is None else word)}"
            for word, value in zip(words, plain.tolist(), strict=True)
        ]
    return ["" if gone else text for gone, text in zip(missing.tolist(), texts, strict=True)]
