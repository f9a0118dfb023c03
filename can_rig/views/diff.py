"""Two runs compared: the settings key by key, the signals row by row."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from can_rig.errors import LogError, did_you_mean
from can_rig.scenario.settings import Scenario, leaves
from can_rig.storage import paged
from can_rig.views.signal_table import SignalTable, in_s
from firmware_model.law.structs import FloatArray

ABOUT_THE_FILE: Final = ("name", "description")
"""Keys without effect on a run."""


@dataclass(frozen=True)
class SettingDifference:
    """One scenario key with different values in two runs."""

    key: str
    a: Any
    b: Any

    def __str__(self) -> str:
        return f"{self.key}: {written(self.a)} → {written(self.b)}"


def differing_settings(a: Scenario, b: Scenario) -> list[SettingDifference]:
    """The keys with different values, in the order of a scenario file.

    A parameter of ``model`` that is the plant's in both runs is not listed beside the plant's.
    """
    values_a, values_b = leaves(a), leaves(b)
    found = []
    for key in {**values_a, **values_b}:  # a plant's own parameters may occur in one run only
        value, other = values_a.get(key), values_b.get(key)
        plant_key = key.replace("model.", "plant.", 1)
        follows = key.startswith("model.") and (
            value == values_a[plant_key] and other == values_b[plant_key]
        )
        if value != other and not follows and key not in ABOUT_THE_FILE:
            found.append(SettingDifference(key, value, other))
    return found


def written(value: Any) -> str:
    """A value in print; "none" for None."""
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class SignalDifference:
    """Difference of one signal between two runs, at common times."""

    signal: str
    tolerance: float
    """Largest accepted difference, in the signal's unit."""
    largest: float
    """Largest difference where both have a value."""
    largest_at_s: float | None
    beyond: int
    """Rows with a difference beyond the tolerance, or with a value in one run only."""
    only_one: int
    """Rows with a value in one run only, included in ``beyond``."""
    first_at_s: float | None
    """Time of the first row counted in ``beyond``."""
    first_a: float | None
    """The values at that time; None: missing."""
    first_b: float | None


@dataclass(frozen=True)
class Difference:
    """How two runs differ."""

    signals: list[SignalDifference]
    rows: int
    """Rows at common times."""
    only_a: int
    """Rows at times in ``a`` only."""
    only_b: int
    columns_a: list[str]
    """Columns in ``a`` only."""
    columns_b: list[str]
    settings: list[SettingDifference] | None = None
    """Keys of the scenarios that differ; None if a scenario is unknown."""

    @property
    def same(self) -> bool:
        """Whether both have the same rows, and every signal is within its tolerance."""
        apart = any(signal.beyond for signal in self.signals)
        return not (apart or self.only_a or self.only_b or self.columns_a or self.columns_b)

    @property
    def first_at_s(self) -> float | None:
        """When the first signal goes beyond its tolerance."""
        return min((s.first_at_s for s in self.signals if s.first_at_s is not None), default=None)

    def as_dict(self) -> dict[str, Any]:
        """Every figure by its name."""
        return {"same": self.same, "first_at_s": self.first_at_s, **asdict(self)}


def compare(a: SignalTable, b: SignalTable, tolerances: Mapping[str, float]) -> Difference:
    """Compare the recorded signals in the rows of the same time.

    Raises:
        LogError: a tolerance names a signal that the runs do not share, or the runs share no time.
    """
    names = [name for name in a.recorded if name in b.recorded]
    for name in tolerances:
        if name not in names:
            hint = did_you_mean(name, names, f"must be one of {', '.join(names)}", 0.5)
            raise LogError(f"--tolerance {name}: not a signal of both runs; {hint}")
    time_ns = a.time_ns
    rows_a: Any = slice(None)
    rows_b: Any = slice(None)
    if not np.array_equal(a.time_ns, b.time_ns):
        time_ns, rows_a, rows_b = np.intersect1d(a.time_ns, b.time_ns, return_indices=True)
    if not len(time_ns):
        raise LogError(f"{a.label} and {b.label}: have no row of the same time")
    paged.let_go()
    time_s = in_s(time_ns)
    signals = [
        _signal(n, time_s, a.columns[n][rows_a], b.columns[n][rows_b], tolerances.get(n, 0.0))
        for n in names
    ]
    return Difference(
        signals,
        len(time_ns),
        len(a.time_ns) - len(time_ns),
        len(b.time_ns) - len(time_ns),
        [name for name in a.recorded if name not in b.recorded],
        [name for name in b.recorded if name not in a.recorded],
        None if not (a.scenario and b.scenario) else differing_settings(a.scenario, b.scenario),
    )


def tolerances_of(texts: Iterable[str]) -> dict[str, float]:
    """Parse ``SIGNAL=VALUE`` texts.

    Raises:
        LogError: a text has another form, or its value is negative or not a number.
    """
    tolerances = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if not (name and value >= 0.0):
            raise LogError(
                f"--tolerance {text}: must be SIGNAL=VALUE with a value of 0 or above, as in "
                "torque_nm=0.01"
            )
        tolerances[name.strip()] = value
    return tolerances


def _signal(
    name: str, time_s: FloatArray, a: FloatArray, b: FloatArray, tolerance: float
) -> SignalDifference:
    largest, largest_at, first, beyond, only = 0.0, None, None, 0, 0
    for rows in paged.blocks(len(time_s)):
        apart = np.abs(a[rows] - b[rows])
        only_one = np.isnan(a[rows]) != np.isnan(b[rows])
        differs = np.flatnonzero(only_one | (apart > tolerance))
        with_values = np.flatnonzero(~np.isnan(apart))
        if len(with_values):
            at = with_values[int(np.argmax(apart[with_values]))]
            if largest_at is None or apart[at] > largest:
                largest, largest_at = float(apart[at]), rows.start + at
        if first is None and len(differs):
            first = rows.start + differs[0]
        beyond += len(differs)
        only += int(only_one.sum())
    return SignalDifference(
        signal=name,
        tolerance=tolerance,
        largest=largest,
        largest_at_s=None if largest_at is None else float(time_s[largest_at]),
        beyond=beyond,
        only_one=only,
        first_at_s=None if first is None else float(time_s[first]),
        first_a=_value(a, first),
        first_b=_value(b, first),
    )


def _value(values: FloatArray, row: Any) -> float | None:
    return None if row is None or np.isnan(values[row]) else float(values[row])
