"""Decoded messages as ASAM MDF 4: a channel group for each message, a channel for each signal."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from asammdf import MDF, Signal, Source
from numpy.typing import NDArray

from can_rig.decoding.files import Contents
from can_rig.decoding.message_decoder import MessageColumns, SignalColumn
from can_rig.logs.frames import NS_PER_S


class DecodedMf4:
    """Collects chunks in a temporary file, and writes ``path`` at the end.

    Time is in float64 seconds since ``start_ns``, as in every MDF file; the sample of a signal that
    is not in a frame is marked invalid. Integers of more than 64 bits are rounded to
    float64. A message without signals has no group, because asammdf adds none without a channel.
    """

    def __init__(self, path: Path, contents: Contents) -> None:
        self._path = path
        self._start_ns = start_ns = contents.start_ns
        self._file: Any = MDF(version="4.10")
        self._file.header.start_time = datetime.fromtimestamp(start_ns // NS_PER_S, UTC)
        self._file.header.abs_time = start_ns
        self._groups: dict[str, int] = {}

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk."""
        for name, columns in chunk.items():
            if not columns.signals:
                continue
            time_s = (columns.time_ns - self._start_ns) / NS_PER_S
            if name in self._groups:
                pairs = [_samples(values) for values in columns.signals.values()]
                self._file.extend(self._groups[name], [(time_s, None), *pairs])
                continue
            signals = [
                _signal(columns.layout[signal], time_s, *_samples(values))
                for signal, values in columns.signals.items()
            ]
            self._groups[name] = self._file.append(
                signals,
                acq_name=name,
                acq_source=Source(name, "", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN),
                comment=name,
                common_timebase=True,
            )

    def close(self) -> None:
        """Finish the file."""
        self._file.save(self._path, overwrite=True, compression=1)
        self._file.close()


def _signal(
    layout: SignalColumn,
    time_s: NDArray[np.float64],
    samples: NDArray[Any],
    invalid: NDArray[np.bool_],
) -> Any:
    return Signal(
        samples,
        time_s,
        unit=layout.unit,
        name=layout.name,
        comment=layout.value_table,
        invalidation_bits=invalid,
    )


def _samples(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    samples = np.ma.getdata(values)
    if samples.dtype == object:
        samples = samples.astype(np.float64)
    return samples, np.ma.getmaskarray(values)
