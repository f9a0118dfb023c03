"""Two columns of a CSV: a time and a value."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterable, Iterator
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
    times, values = array("d"), array("d")
    try:
        with Path(file).open(encoding="utf-8-sig") as lines:
            for number, cells in _rows(lines, where, column):
                numbers = [value for cell in cells if (value := _number(cell)) is not None]
                if len(numbers) != 2 or len(cells) != 2 or not all(map(math.isfinite, numbers)):
                    raise ScenarioError(
                        f"{where}: line {number}: {','.join(cells)!r}: must be two finite "
                        f"numbers, {TIME},{column}"
                    )
                if times and not numbers[0] > times[-1]:
                    raise ScenarioError(
                        f"{where}: line {number}: {numbers[0]:.12g} s after {times[-1]:.12g} s: "
                        "times must increase from row to row"
                    )
                times.append(numbers[0])
                values.append(numbers[1])
    except OSError as error:
        raise ScenarioError(f"{where}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{where}: must be text in UTF-8") from None
    if not times:
        raise ScenarioError(f"{where}: has no rows; must have some of {TIME},{column}")
    if times[0] >= end_s:
        raise ScenarioError(
            f"{where}: begins at {times[0]:.12g} s, and the run ends at {end_s:g} s: "
            "times must be those of the run, from 0 on"
        )
    return np.frombuffer(times), np.frombuffer(values)


def _rows(lines: Iterable[str], where: str, column: str) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line that says something, behind the header."""
    is_first = True
    for number, line in enumerate(lines, 1):
        if not (content := line.partition("#")[0].strip()):
            continue
        cells = [cell.strip() for cell in content.split(",")]
        if is_first and all(_number(cell) is None for cell in cells):
            named = zip(cells, (TIME, column), strict=False)
            if any(_says_another(said, name) for said, name in named):
                raise ScenarioError(
                    f"{where}: line {number}: {','.join(cells)!r}: must be {TIME},{column}"
                )
        else:
            yield number, cells
        is_first = False


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
