"""``bus.plant.csv``: what a simulated plant reports and no frame carries, a row a tick."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import orjson

from can_rig.errors import RunFolderError
from can_rig.logs.plant_signals import plant_signals_path
from firmware_model.target.structs import FloatArray

BUFFER: Final = 1 << 20
"""Bytes between two writes: a slow disk holds up no more than one tick in ten thousand."""


class PlantRecorder:
    """Writes the plant's signals beside the log of its frames.

    Args:
        log: the log; the file has its name with another ending.

    Raises:
        RunFolderError: the file is there already, or cannot be opened or written.
    """

    def __init__(self, log: Path) -> None:
        self._path = plant_signals_path(log)
        self._names: tuple[str, ...] = ()
        try:
            self._file = self._path.open("xb", BUFFER)
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be opened: {error.strerror}") from None

    def record(self, tick: int, signals: Mapping[str, float]) -> None:
        """Note the signals of ``tick``, the same ones in each."""
        names = self._names or tuple(signals)
        self._write(names, [(tick, *(signals.get(name, math.nan) for name in names))])

    def record_columns(self, first_tick: int, columns: Mapping[str, FloatArray]) -> None:
        """Note the signals of the ticks from ``first_tick`` on, (ticks,) each."""
        values = [column.tolist() for column in columns.values()]
        ticks = range(first_tick, first_tick + len(values[0]))
        self._write(tuple(columns), list(zip(ticks, *values, strict=True)))

    def _write(self, names: tuple[str, ...], rows: Sequence[tuple[float, ...]]) -> None:
        """Rows of a tick and its signals, in as few digits as tell each value from all others."""
        # A plant that runs interpreted has numbers of NumPy's, which are floats to all but orjson.
        text = orjson.dumps(rows, default=float)[2:-2].replace(b"],[", b"\n")
        if b"null" in text:  # JSON has no inf and no nan
            text = "\n".join(",".join(map(str, row)) for row in rows).encode()
        try:
            if not self._names:
                self._names = names
                self._file.write(",".join(("tick", *names)).encode() + b"\n")
            self._file.write(text + b"\n")
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be written: {error.strerror}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        with suppress(OSError):  # a full disk has been said by ``record``, or by the log
            self._file.close()
