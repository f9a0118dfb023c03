"""``bus.plant.csv``: what a simulated plant reports and no frame carries, a row a tick."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

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
        RunFolderError: the file cannot be opened or written.
    """

    def __init__(self, log: Path) -> None:
        self._path = plant_signals_path(log)
        self._names: tuple[str, ...] = ()
        try:
            self._file = self._path.open("w", BUFFER, encoding="ascii", newline="\n")
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be opened: {error.strerror}") from None
        self._rows = csv.writer(self._file, lineterminator="\n")

    def record(self, tick: int, signals: Mapping[str, float]) -> None:
        """Note the signals of ``tick``, the same ones in each."""
        try:
            if not self._names:
                self._names = tuple(signals)
                self._rows.writerow(("tick", *self._names))
            self._rows.writerow((tick, *(signals.get(name, math.nan) for name in self._names)))
        except OSError as error:
            raise RunFolderError(f"{self._path}: cannot be written: {error.strerror}") from None

    def record_columns(self, first_tick: int, columns: Mapping[str, FloatArray]) -> None:
        """Note the signals of the ticks from ``first_tick`` on, (ticks,) each."""
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        try:
            if not self._names:
                self._names = tuple(columns)
                self._rows.writerow(("tick", *self._names))
            self._rows.writerows((tick, *row) for tick, row in enumerate(rows, first_tick))
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
