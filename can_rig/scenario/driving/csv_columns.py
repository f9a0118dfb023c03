"""Two columns of a CSV: a time and a value."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from can_rig.errors import ScenarioError
from firmware_model.target.structs import FloatArray


def over_time(file: str, where: str, column: str) -> tuple[FloatArray, FloatArray]:
    """Times, s, and values of a CSV with these two columns; a header may lead.

    Args:
        file: its path.
        where: what begins a refusal.
        column: the name of the second column, with its unit.

    Raises:
        ScenarioError: it cannot be read, has other columns, or its times do not increase.
    """
    try:
        lines = Path(file).read_text(encoding="utf-8-sig").splitlines()
        with warnings.catch_warnings(action="ignore"):  # no rows: refused below
            rows = np.genfromtxt(lines, delimiter=",", ndmin=2)
    except OSError as error:
        raise ScenarioError(f"{where}: cannot be read: {error.strerror}") from None
    except ValueError as error:  # numpy's last line says which row has how many columns
        row = str(error).splitlines()[-1].strip()
        raise ScenarioError(f"{where}: must have rows of time_s,{column}: {row}") from None
    if len(rows) > 1 and np.isnan(rows[0]).all():
        rows = rows[1:]  # the header
    if rows.size == 0 or rows.shape[1] != 2 or not np.isfinite(rows).all():
        raise ScenarioError(f"{where}: must have rows of two finite numbers, time_s,{column}")
    if not (np.diff(rows[:, 0]) > 0).all():
        raise ScenarioError(f"{where}: times must increase from row to row")
    return rows[:, 0].astype(np.float64), rows[:, 1].astype(np.float64)
