"""A recording over time: rows of a CSV as times from 0 on and as columns in the rig's units.

**Times** are seconds of the run, or absolute: seconds since 1970, clock times (``hh:mm:ss``, also
past midnight) or dates with times (ISO 8601). Absolute times count from the first row.

**Columns** are found by their header. A recording without a header has the time and one column.
"""

import csv
import math
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from can_rig.errors import ScenarioError
from firmware_model.law.structs import FloatArray

TIME: Final = "time_s"
NAME: Final = re.compile(r"[A-Za-z]+(_[A-Za-z0-9]+)+")
"""A header's name with a unit, in the rig's style; other headers are free text."""
OTHER_UNITS: Final = re.compile(r"km/?h|kph|mph|\bms\b", re.IGNORECASE)

SINCE_1970_S: Final = 1e8, 1e11
"""Numbers in this range are seconds since 1970: 1973 to 5138."""
SECONDS, HH_MM_SS = "seconds", "hh:mm:ss"
"""Kinds of times, beside dates."""
CLOCK: Final = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:\.\d+)?)")
DAY_S: Final = 86400.0

WORDS: Final = re.compile(r"[a-zµμ]+(?:/[a-z]+)?")
SPLIT_UNIT: Final = re.compile(r"(km|mi|m)[ _.](h|s)(?![a-z])")
ACCELERATION: Final = re.compile(r"(?:m/s|mps|k?m/h|k[mp]h)(?:\^?-?[2²]|/s)")
"""Units that begin like the unit of a speed, in lower case."""
TIME_WORDS: Final = frozenset(
    ("time", "t", "timestamp", "date", "datetime", "clock", "utc", "second", "seconds")
)
SECONDS_PER: Final = {
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "minutes"), 60.0),
    **dict.fromkeys(("h", "hours"), 3600.0),
}
"""Of the units of time that a header may say; the prefix is the micro sign or the Greek letter."""


class Column(NamedTuple):
    """A column of interest.

    Attributes:
        name: with the rig's unit.
        words: words of a header that mean the column.
        factors: of each unit that a header may say, into the rig's unit. Without words and
            factors, the header must be ``name``.
        optional: whether a recording may lack the column.
        gaps: whether a row may lack the value, and is left out then.
    """

    name: str
    words: frozenset[str] = frozenset()
    factors: Mapping[str, float] = {}
    optional: bool = False
    gaps: bool = False


@dataclass(frozen=True)
class Recording:
    """Rows of a recording, n of them.

    Attributes:
        time_s: (n,), ascending.
        values: (n,) for each column, by its name.
        lines: (n,), the number of each row's line.
        skipped: (n,), how many rows without a value stand right before each row.
        unused: headers of other columns.
    """

    time_s: FloatArray
    values: dict[str, FloatArray]
    lines: Sequence[int]
    skipped: Sequence[int]
    unused: tuple[str, ...] = ()


@dataclass
class _Layout:
    """Where the columns stand, and the factors into the rig's units."""

    width: int
    said: str
    places: dict[str, tuple[int, float]]
    time: tuple[int, float] = (0, 1.0)
    unused: tuple[str, ...] = ()


def over_time(file: str, where: str, columns: Sequence[Column], end_s: float) -> Recording:
    """The recording in ``file``.

    Args:
        file: its path.
        where: the begin of a refusal.
        columns: the columns of interest. A single column without ``words`` is the second of two,
            and its header is free text without another unit.
        end_s: end of the run; a recording that begins later would be a constant, and is refused.

    Raises:
        ScenarioError: an unreadable file, other columns, or times that fail to increase.
    """
    try:
        with Path(file).open(encoding="utf-8-sig", newline="") as lines:
            found = _read(_rows(lines, where), where, columns)
    except OSError as error:
        raise ScenarioError(f"{where}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{where}: must be text in UTF-8") from None
    if not len(found.time_s):
        wanted = ",".join([TIME, *(each.name for each in columns if not each.optional)])
        raise ScenarioError(f"{where}: has no rows; must have some of {wanted}")
    if found.time_s[0] >= end_s:
        raise ScenarioError(
            f"{where}: begins at {found.time_s[0]:.12g} s, and the run ends at {end_s:g} s: "
            "times must be those of the run, from 0 on"
        )
    return found


def _rows(lines: Iterable[str], where: str) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line that says something.

    Cells are separated by commas. In a file whose first such line has a semicolon or a tab, that
    sign separates, and a comma is a decimal comma.
    """
    separator = ""
    for number, line in enumerate(lines, 1):
        if "\0" in line:
            raise ScenarioError(f"{where}: line {number}: must be text, without NUL")
        if not (content := line.partition("#")[0].strip("\r\n ")).strip():
            continue
        if not separator:
            separator = next((sign for sign in ";\t" if sign in content), ",")
        try:
            cells = next(csv.reader([content], delimiter=separator, strict=True))
        except csv.Error:
            raise ScenarioError(
                f"{where}: line {number}: {content!r}: must have quotation marks in pairs"
            ) from None
        if separator != ",":
            cells = [cell.replace(",", ".") for cell in cells]
        yield number, [cell.strip() for cell in cells]


@dataclass
class _Times:
    """Times of the rows, in s from 0 on, or from the first row on."""

    where: str
    factor: float = 1.0
    kind: str = ""
    first_s: float = 0.0
    days: int = 0
    last_s: float = -math.inf

    def of(self, number: int, said: str) -> float:
        """The time of a row in line ``number``."""
        where = f"{self.where}: line {number}"
        kind, value_s = _instant(said)
        if not kind:
            raise ScenarioError(
                f"{where}: {said!r}: must be a time: seconds, hh:mm:ss, or a date with a time, "
                "as in 2026-05-04T10:00:00"
            )
        if kind == SECONDS:
            value_s *= self.factor
        if not self.kind:
            self.kind = kind
            if kind == SECONDS and value_s >= SINCE_1970_S[1]:
                raise ScenarioError(
                    f"{where}: {said} s: must be seconds; a header time_ms says milliseconds"
                )
            of_the_run = kind == SECONDS and value_s < SINCE_1970_S[0]
            self.first_s = 0.0 if of_the_run else value_s
        if kind != self.kind:
            raise ScenarioError(f"{where}: {said!r}: must be {self.kind} like the time before")
        time_s = value_s - self.first_s
        if kind == HH_MM_SS:
            time_s += DAY_S * self.days
            if time_s < self.last_s - 0.5 * DAY_S:  # past midnight
                self.days += 1
                time_s += DAY_S
        elif kind != SECONDS:
            time_s = round(time_s, 6)  # a date has microseconds
        if not time_s > self.last_s:
            raise ScenarioError(
                f"{where}: {time_s:.12g} s after {self.last_s:.12g} s: "
                "times must increase from row to row"
            )
        self.last_s = time_s
        return time_s


def _instant(said: str) -> tuple[str, float]:
    """The kind of a time, "" for none, and its seconds."""
    number = _number(said)
    if number is not None and math.isfinite(number):
        return SECONDS, number
    if clock := CLOCK.fullmatch(said):
        hours, minutes, seconds = (float(part) for part in clock.groups())
        if hours < 24.0 and minutes < 60.0 and seconds < 61.0:
            return HH_MM_SS, 3600.0 * hours + 60.0 * minutes + seconds
        return "", 0.0
    try:
        date = datetime.fromisoformat(said)
    except ValueError:
        return "", 0.0
    if date.tzinfo is None:
        return "a date and a time without a time zone", date.replace(tzinfo=UTC).timestamp()
    return "a date and a time with a time zone", date.timestamp()


def _read(
    rows: Iterator[tuple[int, list[str]]], where: str, columns: Sequence[Column]
) -> Recording:
    layout: _Layout | None = None
    times, lines, skipped = array("d"), array("q"), array("q")
    values = {column.name: array("d") for column in columns}
    clock, missing = _Times(where), 0
    for number, cells in rows:
        if layout is None:
            layout = _layout_of(f"{where}: line {number}", cells, columns)
            clock.factor = layout.time[1]
            if not _is_data(cells):
                continue
        row = _values(layout, cells, columns)
        if row is None:
            raise ScenarioError(
                f"{where}: line {number}: {','.join(cells)!r}: must be {layout.said}"
            )
        time_s = clock.of(number, cells[layout.time[0]])
        if any(math.isnan(value) for value in row.values()):
            missing += 1
            continue
        times.append(time_s)
        lines.append(number)
        skipped.append(missing)
        missing = 0
        for name, value in row.items():
            values[name].append(value)
    places = layout.places if layout else {}
    return Recording(
        np.frombuffer(times),
        {name: np.frombuffer(column) for name, column in values.items() if name in places},
        lines,
        skipped,
        layout.unused if layout else (),
    )


def _values(
    layout: _Layout, cells: Sequence[str], columns: Sequence[Column]
) -> dict[str, float] | None:
    """The values of a row, nan for a gap; None for a row without a valid value."""
    found = {}
    if len(cells) != layout.width:
        return None
    for column in columns:
        if column.name not in layout.places:
            continue
        place, factor = layout.places[column.name]
        said = cells[place]
        value = _number(said)
        if column.gaps and (said == "" or (value is not None and math.isnan(value))):
            found[column.name] = math.nan
        elif value is None or not math.isfinite(value):
            return None
        else:
            found[column.name] = value * factor
    return found


def _is_data(cells: Sequence[str]) -> bool:
    """Whether a first line is a row and not a header."""
    return any(_instant(cell)[0] or _number(cell) is not None for cell in cells)


def _layout_of(where: str, cells: Sequence[str], columns: Sequence[Column]) -> _Layout:
    """The places of the columns, by the first line."""
    first = columns[0]
    plain = _Layout(2, f"two finite numbers, {TIME},{first.name}", {first.name: (1, 1.0)})
    if _is_data(cells):
        return plain
    if not first.words:
        named = zip(cells, (TIME, first.name), strict=False)
        if any(_says_another(said, name) for said, name in named):
            raise ScenarioError(f"{where}: {','.join(cells)!r}: must be {TIME},{first.name}")
        return plain
    return _named_layout(where, cells, columns)


def _says_another(said: str, name: str) -> bool:
    """Whether a column's header names another quantity or another unit than ``name``."""
    names_one = NAME.fullmatch(said) is not None and said.lower() != name
    times = name == TIME and not SECONDS_PER.keys().isdisjoint(WORDS.findall(said.lower()))
    return names_one or times or OTHER_UNITS.search(said) is not None


def _named_layout(where: str, cells: Sequence[str], columns: Sequence[Column]) -> _Layout:
    """The places of the columns, by the words and units of a header."""
    plain = (ACCELERATION.sub("", SPLIT_UNIT.sub(r"\1/\2", cell.lower())) for cell in cells)
    words = [WORDS.findall(cell) for cell in plain]
    places, free = {}, set(range(len(cells)))
    for column in columns:
        exact = [at for at in sorted(free) if cells[at].lower() == column.name]
        of_words = [at for at in sorted(free) if column.words.intersection(words[at])]
        at = _only(where, cells, exact or of_words, column)
        if at is None:
            if not column.optional:
                raise ScenarioError(
                    f"{where}: {','.join(cells)!r}: must have a column {_forms(column)}"
                )
            continue
        factor = 1.0 if exact else _factor(where, cells[at], words[at], column)
        places[column.name] = at, factor
        free.discard(at)
    timed = [at for at in sorted(free) if TIME_WORDS.intersection(words[at])]
    at = _only(where, cells, [at for at in timed if cells[at].lower() == TIME] or timed, TIME)
    if at is None:
        raise ScenarioError(f"{where}: {','.join(cells)!r}: must have a column {TIME}")
    free.discard(at)
    unit = next((SECONDS_PER[word] for word in words[at] if word in SECONDS_PER), 1.0)
    known = [column.name for column in columns]
    for other in sorted(free):
        if near := get_close_matches(cells[other].lower(), known, 1, 0.8):
            raise ScenarioError(f"{where}: {cells[other]!r}: must be {near[0]}")
    said = f"{len(cells)} cells: a time and finite numbers, {','.join(cells)}"
    return _Layout(len(cells), said, places, (at, unit), tuple(cells[k] for k in sorted(free)))


def _only(where: str, cells: Sequence[str], found: Sequence[int], of: Column | str) -> int | None:
    """The only place found, or None."""
    if len(found) > 1:
        name = of if isinstance(of, str) else of.name
        raise ScenarioError(
            f"{where}: {cells[found[0]]!r} and {cells[found[1]]!r}: must be one column, {name}"
        )
    return found[0] if found else None


def _factor(where: str, said: str, words: Sequence[str], column: Column) -> float:
    """Of a column's unit into the rig's."""
    units = [word for word in words if word in column.factors]
    if len(units) != 1:
        raise ScenarioError(f"{where}: {said!r}: must say its unit: {_forms(column)}")
    return column.factors[units[0]]


def _forms(column: Column) -> str:
    """How a header may name a column."""
    stem = column.name.rpartition("_")[0]
    units = [f"{stem}_{unit}" for unit in ("mps", "kmh", "mph") if unit in column.factors]
    return " or ".join(units) or column.name


def _number(text: str) -> float | None:
    """The number in ``text``, finite or not; None for other text."""
    try:
        return float(text)
    except ValueError:
        return None
