"""Two columns of a CSV: a time and a value."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Final

import numpy as np

from can_rig.errors import ScenarioError
from firmware_model.target.structs import FloatArray

TIME: Final = "time_s"
NAME: Final = re.compile(r"[A-Za-z]+(_[A-Za-z0-9]+)+")
"""A header's name with a unit, in the rig's style; other headers are free text."""
OTHER_UNITS: Final = re.compile(r"km/?h|kph|mph|\bms\b", re.IGNORECASE)


def over_time(file: str, where: str, column: str, end_s: float) -> tuple[FloatArray, FloatArray]:
    """Times, s, and values of a CSV with these two columns; a header line is optional.

    Args:
        file: its path.
        where: the begin of a refusal.
        column: the name of the second column, with its unit.
        end_s: end of the run; a recording that begins later would be a constant, and is refused.

    Raises:
        ScenarioError: an unreadable file, other columns, or times that fail to increase.
    """
    try:
        lines = Path(file).read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise ScenarioError(f"{where}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{where}: must be text in UTF-8") from None
    rows = [
        (number, [cell.strip() for cell in content.split(",")])
        for number, line in enumerate(lines, 1)
        if (content := line.partition("#")[0].strip())
    ]
    if rows and all(_number(cell) is None for cell in rows[0][1]):
        number, header = rows.pop(0)
        if any(
            _says_another(said, name) for said, name in zip(header, (TIME, column), strict=False)
        ):
            raise ScenarioError(
                f"{where}: line {number}: {','.join(header)!r}: must be {TIME},{column}"
            )
    if not rows:
        raise ScenarioError(f"{where}: has no rows; must have some of {TIME},{column}")
    found: list[tuple[float, float]] = []
    for number, cells in rows:
        numbers = [value for cell in cells if (value := _number(cell)) is not None]
        if len(numbers) != 2 or len(cells) != 2 or not all(map(math.isfinite, numbers)):
            raise ScenarioError(
                f"{where}: line {number}: {','.join(cells)!r}: must be two finite numbers, "
                f"{TIME},{column}"
            )
        time_s, value = numbers
        if found and not time_s > found[-1][0]:
            raise ScenarioError(
                f"{where}: line {number}: {time_s:.12g} s after {found[-1][0]:.12g} s: "
                "times must increase from row to row"
            )
        found.append((time_s, value))
    if found[0][0] >= end_s:
        raise ScenarioError(
            f"{where}: begins at {found[0][0]:.12g} s, and the run ends at {end_s:g} s: "
            "times must be those of the run, from 0 on"
        )
    times, values = np.array(found, dtype=np.float64).T
    return times, values


def _says_another(said: str, name: str) -> bool:
    """Whether a column's header names another quantity or another unit than ``name``."""
    names_one = NAME.fullmatch(said) is not None and said.lower() != name
    return names_one or OTHER_UNITS.search(said) is not None


def _number(text: str) -> float | None:
    """The number in ``text``, finite or not; None for other text."""
    try:
        return float(text)
    except ValueError:
        return None
