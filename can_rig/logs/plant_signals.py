"""The file beside a log that holds what the simulated plant reported and no frame carries."""

import zlib
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.logs.compression import open_text, stored
from can_rig.storage import paged

PlantSignals = dict[str, NDArray[np.float64]]


def plant_signals_path(log: Path) -> Path:
    """``bus.log`` or ``bus.log.gz`` → ``bus.plant.csv``."""
    return log.with_name(log.name.removesuffix(".gz")).with_suffix(".plant.csv")


def read_plant_signals(log: Path, first_tick: int, ticks: int) -> PlantSignals:
    """The plant's signals by name, (ticks,) each, from ``first_tick`` on; nan for missing values.

    A log alone has no plant signals. A last line that a killed run left unfinished is not read.

    Raises:
        LogError: the file exists but cannot be read.
    """
    path = plant_signals_path(log)
    try:
        path = stored(path)
        if not path.is_file():
            return {}
    except OSError:  # no file has a name of this length
        return {}
    columns: PlantSignals = {}
    try:
        with open_text(path) as file:
            names = file.readline().rstrip("\n").split(",")[1:]
            while lines := list(islice(file, paged.BLOCK_ROWS)):
                if not lines[-1].endswith("\n"):
                    lines.pop()
                if lines and not columns:
                    columns = {name: _unknown(ticks) for name in names}
                if lines:
                    _take(lines, columns, first_tick)
    except (OSError, EOFError, zlib.error, ValueError) as error:
        raise LogError(f"{path}: not readable as signals of a plant: {error}") from None
    return columns


def _unknown(ticks: int) -> NDArray[np.float64]:
    return paged.column(ticks, lambda rows: np.full(rows.stop - rows.start, np.nan))


def _take(lines: list[str], columns: PlantSignals, first_tick: int) -> None:
    table = np.loadtxt(lines, delimiter=",", ndmin=2)
    if table.shape[1] != len(columns) + 1:
        raise ValueError(f"{table.shape[1]} columns below {len(columns) + 1} names")
    at = table[:, 0].astype(np.int64) - first_tick
    for column, values in zip(columns.values(), table[:, 1:].T, strict=True):
        within = (at >= 0) & (at < len(column))
        column[at[within]] = values[within]
    paged.let_go()
