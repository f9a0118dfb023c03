"""A run as columns of ``signals.csv``, whether it is a run folder, such a file or a log."""

from __future__ import annotations

import csv
import zlib
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from can_rig.drawing.names import OF_SIGNALS, column_names, in_words, names_of
from can_rig.errors import LogError, ScenarioError
from can_rig.logs.columns import EVIDENCE_OF, ON_THE_BUS, VERDICT
from can_rig.logs.compression import open_text, stored
from can_rig.logs.frames import ALL, NS_PER_S, Window
from can_rig.logs.reading import content_format, read_log
from can_rig.results.run_folder import SIGNALS, recorded_scenario
from can_rig.results.signals import Signals, cell, signals_of, with_plant_signals
from can_rig.results.source import log_path
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load_run
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.law.structs import FloatArray

TIME: Final = "time_s"


@dataclass(frozen=True)
class SignalTable:
    """Signals over a common time axis."""

    label: str
    """The file or folder of the signals."""
    time_ns: NDArray[np.int64]
    """(n,) increasing."""
    columns: dict[str, FloatArray]
    """(n,) by name, as in ``signals.csv``; nan in an empty cell."""
    scenario: Scenario | None = None
    """The executed scenario, if known."""
    notice: str | None = None
    """One line if the end of a log is missing."""
    left_out: int = 0
    """Feedback frames of a log that do not go on from those before."""

    @property
    def time_s(self) -> FloatArray:
        """(n,) the time axis in s."""
        return in_s(self.time_ns)

    @property
    def recorded(self) -> dict[str, FloatArray]:
        """The columns without the verdict and its evidence, which are derived columns."""
        return {
            name: column
            for name, column in self.columns.items()
            if name != VERDICT and not name.startswith(EVIDENCE_OF)
        }

    def within(self, window: Window) -> SignalTable:
        """The rows of a part of the recording, which began with the first row.

        Raises:
            LogError: the part has no rows.
        """
        since_ns = self.time_ns - self.time_ns[:1]
        first, end = np.searchsorted(since_ns, window)
        rows = slice(int(first), int(end))
        if len(since_ns) and first == end:
            last_s = since_ns[-1] / NS_PER_S
            raise LogError(f"{self.label}: has no row of that part, the last is at {last_s:g} s")
        columns = {name: column[rows] for name, column in self.columns.items()}
        return replace(self, time_ns=self.time_ns[rows], columns=columns)

    def name_and_unit(self, column: str) -> tuple[str, str]:
        """Printed name and unit of a column; "" without a unit."""
        plant = PlantSettings() if self.scenario is None else self.scenario.plant
        names, in_file = names_of(plant), column_names(plant)
        for of_car, (of, _, words) in OF_SIGNALS.items():
            if column in (of_car, in_file[of_car]):
                return words.format(names[of].name), names[of].unit
        return in_words(column)


def titles(a: SignalTable, b: SignalTable) -> tuple[str, str]:
    """A name for each of two runs: the shortest distinct end of its path, and its scenario."""
    parts_a, parts_b = Path(a.label).parts, Path(b.label).parts
    tail = 1
    while parts_a[-tail:] == parts_b[-tail:] and tail < max(len(parts_a), len(parts_b)):
        tail += 1
    return _title(a, parts_a[-tail:]), _title(b, parts_b[-tail:])


def _title(table: SignalTable, parts: tuple[str, ...]) -> str:
    name = str(Path(*parts))
    return name if table.scenario is None else f"{name} ({table.scenario.name})"


def read_part(path: Path, scenario: Scenario, window: Window) -> SignalTable:
    """A part of what ``read_table`` reads; of a log with several runs, the run of that part.

    Raises:
        LogError: as ``read_table``, or the part has no rows.
    """
    table = read_table(path, scenario)
    try:
        return table.within(window)
    except LogError:
        if not table.left_out:
            raise
    return read_table(path, scenario, window)


def read_table(path: Path, scenario: Scenario, window: Window = ALL) -> SignalTable:
    """A run folder, its ``signals.csv``, or a log.

    Args:
        path: the path.
        scenario: describes the frames and the tick of a log.
        window: the frames of a log to read.

    Raises:
        LogError: the path is none of the three, or cannot be read.
    """
    if path.is_dir():
        file = stored(path / SIGNALS)
        if not file.is_file():
            raise LogError(f"{path}: not a finished run folder, it has no {SIGNALS}")
        return _from_csv(file, str(path), scenario_of(path))
    if path.name.lower().removesuffix(".gz").endswith(".csv") and content_format(path) is None:
        return _from_csv(log_path(path), str(path), None)
    log = read_log(log_path(path), window=window)
    signals = signals_of(log, network_of(scenario), scenario.tick_s)
    signals = with_plant_signals(signals, log.path, scenario.tick_s)
    if not len(signals):
        raise LogError(f"{path}: has no usable frame of the rig")
    table = table_of(signals, str(path), scenario)
    return replace(table, scenario=None, notice=log.notice, left_out=signals.left_out)


def table_of(signals: Signals, label: str, scenario: Scenario) -> SignalTable:
    """The columns of a decoded log, named and rounded as in ``signals.csv``."""
    names = column_names(scenario.plant, signals.plant)
    columns = {name: getattr(signals, name) for name in ON_THE_BUS if name != TIME} | signals.plant
    columns = {
        names.get(name, name): paged.column(len(signals), partial(_rounded, column))
        for name, column in columns.items()
    }
    return SignalTable(label, _whole_ns(signals.time_s), columns, scenario)


def _rounded(column: FloatArray, rows: slice) -> FloatArray:
    return np.array([float(cell(x) or "nan") for x in column[rows].tolist()])


def scenario_of(folder: Path) -> Scenario | None:
    """The scenario recorded in a run folder; None without a record, and for a log."""
    try:
        return load_run(recorded_scenario(folder)[0])
    except ScenarioError:
        return None


def _from_csv(path: Path, label: str, scenario: Scenario | None) -> SignalTable:
    try:
        columns = _columns_of(path)
    except (EOFError, zlib.error) as error:
        raise LogError(f"{path}: the compressed file is damaged: {error}") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # no header, a cell that is no number, rows of different lengths
        raise LogError(f"{path}: not a table of numbers under one header: {error}") from None
    if TIME not in columns:
        raise LogError(f"{path}: has no column {TIME}; its columns are {', '.join([*columns][:8])}")
    time_ns = _whole_ns(columns.pop(TIME))
    if not (np.diff(time_ns) > 0).all():
        raise LogError(f"{path}: {TIME} does not increase from row to row")
    return SignalTable(label, time_ns, columns, scenario)


def _columns_of(path: Path) -> dict[str, FloatArray]:
    """The columns of a table under one header, an empty cell as nan."""
    with paged.rows_file(8 * paged.PAGED_ROWS) as cells:
        with open_text(path, "utf-8-sig") as file:
            rows = (row for row in csv.reader(file) if row)
            header = next(rows, [])
            if not header:
                raise ValueError("it is empty")
            while block := list(islice(rows, paged.BLOCK_ROWS)):
                part = [[float(cell) if cell else np.nan for cell in row] for row in block]
                if any(len(row) != len(header) for row in part):
                    raise ValueError("its rows have different lengths")
                paged.append(cells, part)
        return dict(zip(header, paged.columns(cells, len(header)), strict=True))


def in_s(time_ns: NDArray[np.int64]) -> FloatArray:
    """(n,) times in s."""
    return paged.column(
        len(time_ns), lambda rows: np.multiply(time_ns[rows], 1e-9, dtype=np.float64)
    )


def _whole_ns(time_s: FloatArray) -> NDArray[np.int64]:
    """Times in whole ns; equal ticks give equal times in two runs."""
    time_ns = paged.empty(len(time_s)).view(np.int64)
    for rows in paged.blocks(len(time_s)):
        time_ns[rows] = np.rint(time_s[rows] * 1e9)
    return time_ns
