"""A run as columns of ``signals.csv``, whether it is a run folder, such a file or a log."""

from __future__ import annotations

import csv
import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.frames.messages import Network
from can_rig.logs.reading import read_log
from can_rig.results.run_folder import SIGNALS, SUMMARY
from can_rig.results.signals import COLUMNS, Signals, cell, signals_of
from can_rig.results.source import log_path
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import FaultSettings, Scenario
from firmware_model.discretisation.sections import FloatArray

TIME: Final = "time_s"

_UNITS: Final = (  # suffix of a column, longest first
    ("_mps2", "m/s²"),
    ("_nm", "N m"),
    ("_n", "N"),
)


@dataclass(frozen=True)
class SignalTable:
    """Signals over one time axis."""

    label: str
    time_ns: NDArray[np.int64]
    """(n,) increasing."""
    columns: dict[str, FloatArray]
    """(n,) by name, as in ``signals.csv``; nan in an empty cell."""
    fault: FaultSettings | None = None
    """What was lost in it, if that is known."""

    @property
    def time_s(self) -> FloatArray:
        """(n,) the time axis in s."""
        return np.multiply(self.time_ns, 1e-9, dtype=np.float64)


def unit(column: str) -> str:
    """The unit of a column by the suffix of its name; none without one."""
    return next((text for suffix, text in _UNITS if column.endswith(suffix)), "")


def read_table(path: Path, scenario: Scenario) -> SignalTable:
    """A run folder, its ``signals.csv``, or a log.

    Args:
        path: which one.
        scenario: of a log: its frames and its tick.

    Raises:
        LogError: it is none of these, or cannot be read.
    """
    if path.is_dir():
        if not (path / SIGNALS).is_file():
            raise LogError(f"{path}: not a finished run folder, it has no {SIGNALS}")
        return _from_csv(path / SIGNALS, str(path), fault_of(path))
    if path.suffix.lower() == ".csv":
        return _from_csv(log_path(path), str(path), None)
    log = read_log(log_path(path))
    messages = (message for frames in log for message in frames.messages())
    signals = signals_of(messages, network_of(scenario), scenario.tick_s)
    if not len(signals):
        raise LogError(f"{path}: has no frame of the rig that can be used")
    return table_of(signals, str(path))


def table_of(signals: Signals, label: str, fault: FaultSettings | None = None) -> SignalTable:
    """The columns of a log that has been read, rounded as ``signals.csv`` would have them."""
    columns = {
        name: np.array([float(cell(x) or "nan") for x in getattr(signals, name).tolist()])
        for name in COLUMNS
        if name != TIME
    }
    return SignalTable(label, _whole(signals.time_s), columns, fault)


def units_of(network: Network) -> dict[str, str]:
    """Units of the columns in another network, where they are not what the names say."""
    readable = {"m/s^2": "m/s²", "N.m": "N m"}
    codecs = {
        "reference_mps2": network.reference,
        "dstar_mps2": network.feedback,
        "error_mps2": network.feedback,
        "torque_nm": network.command_1,
        "force_difference_n": network.command_2,
        "fault_estimate_mps2": network.status,
    }
    return {name: readable.get(codec.unit, codec.unit) for name, codec in codecs.items()}


def fault_of(folder: Path) -> FaultSettings | None:
    """What a run folder says was lost; None where it says nothing."""
    try:
        values: Any = json.loads((folder / SUMMARY).read_text("utf-8"))["scenario"]["fault"]
        known = {field.name for field in dataclasses.fields(FaultSettings)}
        return FaultSettings(**{key: value for key, value in values.items() if key in known})
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _from_csv(path: Path, label: str, fault: FaultSettings | None) -> SignalTable:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header, *rows = csv.reader(file)
        cells = [[float(cell) if cell else np.nan for cell in row] for row in rows if row]
        values = np.array(cells, dtype=np.float64).reshape(len(cells), len(header)).T
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:  # no header, a cell that is no number, rows of different lengths
        raise LogError(f"{path}: not a table of numbers under one header: {error}") from None
    columns = dict(zip(header, values, strict=True))
    if TIME not in columns:
        raise LogError(f"{path}: has no column {TIME}; {', '.join(header[:8])} are there")
    time_ns = _whole(columns.pop(TIME))
    if not (np.diff(time_ns) > 0).all():
        raise LogError(f"{path}: {TIME} does not increase from row to row")
    return SignalTable(label, time_ns, columns, fault)


def _whole(time_s: FloatArray) -> NDArray[np.int64]:
    """Whole ns: two runs of the same tick have the same."""
    return np.rint(time_s * 1e9).astype(np.int64)
