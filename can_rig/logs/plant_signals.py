"""The file beside a log that holds what the simulated plant reported and no frame carries."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import LogError

PlantSignals = dict[str, NDArray[np.float64]]


def plant_signals_path(log: Path) -> Path:
    """``bus.log`` → ``bus.plant.csv``."""
    return log.with_suffix(".plant.csv")


def read_plant_signals(log: Path, first_tick: int, ticks: int) -> PlantSignals:
    """The plant's signals by name, (ticks,) each, from ``first_tick`` on; nan for missing values.

    A log alone has no plant signals. A last line that a killed run left unfinished is not read.

    Raises:
        LogError: the file exists but cannot be read.
    """
    path = plant_signals_path(log)
    if not path.is_file():
        return {}
    try:
        text = path.read_text("utf-8")
        whole = text[: text.rfind("\n") + 1]
        head, _, rows = whole.partition("\n")
        names = head.split(",")[1:]
        if not rows:
            return {}
        table = np.loadtxt(io.StringIO(rows), delimiter=",", ndmin=2)
        if table.shape[1] != len(names) + 1:
            raise ValueError(f"{table.shape[1]} columns below {len(names) + 1} names")
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: not readable as signals of a plant: {error}") from None
    at = table[:, 0].astype(np.int64) - first_tick
    within = (at >= 0) & (at < ticks)
    columns = np.full((len(names), ticks), np.nan)
    columns[:, at[within]] = table[within, 1:].T
    return dict(zip(names, columns, strict=True))
