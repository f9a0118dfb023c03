"""From a campaign's keys to the settings of each of its runs, which its number alone decides."""

import math
import operator
import shlex
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy.stats import qmc

from can_rig.campaigns.settings import (
    MOST_RUNS,
    SCENARIO,
    Alternative,
    AxisSettings,
    CampaignSettings,
    Scalar,
)
from can_rig.errors import ScenarioError
from can_rig.scenario.loading import LIMITS, Written, as_settings, value_in, written
from can_rig.scenario.plant_settings import SHORTEST_LAG_S
from can_rig.scenario.sensor_settings import MEASURED
from can_rig.scenario.settings import LISTS, Scenario
from firmware_model.law.structs import FloatArray

DIGITS: Final = 9
"""Significant digits of a drawn value: the run uses exactly the printed number."""

LAGS: Final = ("lag_s", "natural_frequency_rad_per_s")
"""Alternative keys of an actuator; each actuator has one key of the two."""

ROUNDING: Final = 1e-9
"""Of a number in ticks that other keys change, which rounds up."""

OPERATIONS: Final[dict[str, Callable[[float, float], float]]] = {
    "times": operator.mul,
    "per": operator.truediv,
    "plus": operator.add,
}
"""How the value of another key changes a drawn value."""

NOT_BELIEVED: Final = ("kind", "variant", "parameters", "friction")
"""Keys of ``plant`` that ``model`` lacks or need not keep."""


@dataclass(frozen=True)
class Base:
    """A scenario of a campaign with the settings of every run."""

    settings: CampaignSettings
    file: Written

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario with the campaign's settings, before any axis changes it."""
        return self.file.with_changes(self._common, "").scenario

    @cached_property
    def values(self) -> dict[str, Any]:
        """Every key of ``scenario``."""
        return self.scenario.as_dict()

    def value(self, key: str) -> Any:
        """The value of a key, also in a fault or disturbance that the scenario lacks."""
        name, _, own = key.partition(".")
        number, _, rest = own.partition(".")
        listed = self.values.get(name)
        if name in LISTS and number.isdecimal():
            known = len(listed) if isinstance(listed, list) else 1
            if int(number) >= known:
                return getattr(LISTS[name], rest, None)
        return value_in(self.values, key)

    def has(self, key: str) -> bool:
        """Whether the key exists, set or not."""
        table = value_in(self.values, key.rpartition(".")[0])
        return isinstance(table, dict) and key.rpartition(".")[2] in table

    def possible(self, alternatives: Mapping[str, Alternative]) -> list[str]:
        """The names of the alternatives whose further sensors the scenario has."""
        lacking = {*MEASURED} - {each.measures for each in self.scenario.sensors}
        return [
            name
            for name, keys in alternatives.items()
            if not any(lacking & {*map(str, axis.values or ())} for axis in keys.values())
        ]

    def drawn(self, key: str, axis: AxisSettings, unit: float) -> Scalar:
        """The value of an axis at a position in [0, 1], without the values of other keys."""
        sign = 1.0
        if axis.either_sign:
            sign, unit = math.copysign(1.0, unit - 0.5), abs(2.0 * unit - 1.0)
        if axis.values is not None:
            chosen = axis.values[min(int(unit * len(axis.values)), len(axis.values) - 1)]
            return sign * chosen if axis.either_sign and not isinstance(chosen, str) else chosen
        low, high = self._ends(key, axis)
        whole = isinstance(self.value(key), int) and not axis.others
        if whole and self.settings.sampling != "grid":
            if math.ceil(low) > high:
                raise ScenarioError(
                    f"axes.{key}: {low:g} to {high:g}: must have a whole number, "
                    f"as {key} = {self.value(key)} in the scenario is"
                )
            low, high = float(math.ceil(low)), math.floor(high) + 1.0
        if axis.scale == "log":
            value = math.exp(math.log(low) + unit * (math.log(high) - math.log(low)))
        else:
            value = low + unit * (high - low)
        if axis.others:
            return sign * value
        if whole and self.settings.sampling == "grid":
            return round(sign * value)
        if whole:
            return round(sign * min(max(math.floor(value), low), high - 1.0))
        value = float(f"{sign * value:.{DIGITS}g}")
        if key.endswith(".lag_s") and 0.0 < value < SHORTEST_LAG_S:  # shorter lags do not exist
            return 0.0 if value < 0.5 * SHORTEST_LAG_S else SHORTEST_LAG_S
        return value

    def depending(self, key: str, axis: AxisSettings, values: Mapping[str, Scalar]) -> Scalar:
        """The value of an axis whose drawn value other keys change; ``values`` are of the run.

        Raises:
            ScenarioError: another key has no number.
        """
        value = float(values[key])
        for how, other in (("times", axis.times), ("per", axis.per), ("plus", axis.plus)):
            if other is None:
                continue
            number = values.get(other, self.value(other))
            if isinstance(number, bool) or not isinstance(number, int | float):
                raise ScenarioError(
                    f"{key}: {how} = {other!r}: must be a key with "
                    f"a number in each run; there it is {number!r}"
                )
            if how == "per" and number == 0.0:
                raise ScenarioError(f"{key}: per = {other!r}: must not be 0")
            value = OPERATIONS[how](value, float(number))
        if isinstance(self.value(key), int):
            return math.ceil(value - ROUNDING)
        return float(f"{value:.{DIGITS}g}")

    def scenario_with(self, changes: dict[str, Scalar]) -> Scenario:
        """The scenario of a run: the common settings, then these values.

        Raises:
            ScenarioError: an unknown key, or an invalid value.
        """
        return self._file_of_all.with_changes(as_settings(changes), "").scenario

    def command_with(self, changes: dict[str, Scalar]) -> str:
        """The command that repeats a run with these values, frames included."""
        words = ["can-rig", "run", self.file.given, "--in-process", "--allow-unstable"]
        for change in [*self._of_all, *as_settings(changes)]:
            words += ["--set", change]
        return shlex.join(words)

    @cached_property
    def _common(self) -> list[str]:
        return as_settings(self.settings.settings)

    @cached_property
    def _of_all(self) -> list[str]:
        """Changes common to all runs, applied before the axes."""
        return [*self._common, *self._kept_beliefs]

    @cached_property
    def _file_of_all(self) -> Written:
        return self.file.with_changes(self._of_all, "")

    @cached_property
    def _kept_beliefs(self) -> list[str]:
        """Settings that keep what the controller believes where an axis changes the car."""
        if self.settings.redesign:
            return []
        kept: dict[str, Any] = {}
        for key in self.settings.keys:
            table, _, part = key.partition(".")
            last = part.rpartition(".")[2]
            if table != "plant" or part.startswith(NOT_BELIEVED) or last.startswith(LIMITS):
                continue
            if not self.has(f"model.{part}"):  # the run will say so
                continue
            stage = part.rpartition(".")[0]
            parts = [f"{stage}.{lag}" for lag in LAGS] if last in LAGS else [part]
            known = {each: value_in(self.values, f"model.{each}") for each in parts}
            if not any(known.values()) and last in LAGS:
                known = {f"{stage}.lag_s": 0.0}
            for each, value in known.items():
                if value is None and len(known) == 1:
                    raise ScenarioError(
                        f"axes.{key}: model.{part} must be set, so "
                        "that the controller's belief stays as it is, or redesign = true"
                    )
                if value or len(known) == 1:
                    kept[f"model.{each}"] = value
        return as_settings({k: v for k, v in kept.items() if k not in self.settings.keys})

    def _ends(self, key: str, axis: AxisSettings) -> tuple[float, float]:
        if axis.range is not None:
            return axis.range
        own = value_in(self.values, key)
        if not self.has(key):
            wrong = self.file.with_changes([*self._common, f"{key}=1"], "")
            _ = wrong.scenario  # the error lists valid keys
        if isinstance(own, bool) or not isinstance(own, int | float) or own == 0.0:
            raise ScenarioError(
                f"axes.{key}.share = {axis.share}: {key} = {own!r} "
                "in the scenario; must be a number other than 0, or the axis have a range"
            )
        share = axis.share or 0.0
        low, high = own * (1.0 - share), own * (1.0 + share)
        return (low, high) if own > 0.0 else (high, low)


@dataclass(frozen=True)
class Plan:
    """A campaign ready to run."""

    settings: CampaignSettings
    bases: dict[str, Base]

    @cached_property
    def base(self) -> Base:
        """The first scenario."""
        return next(iter(self.bases.values()))

    @cached_property
    def runs(self) -> int:
        """Number of runs."""
        if self.settings.sampling != "grid":
            return self.searched + (self.settings.runs or 0)
        return math.prod(self._shape) * self.settings.repeats

    @property
    def searched(self) -> int:
        """Number of runs that belong to a search; searched runs come first.

        Only the search knows their values.
        """
        return 0 if self.settings.search is None else self.settings.runs or 0

    @cached_property
    def dimensions(self) -> int:
        """Number of numbers in [0, 1] that decide a run: of axes, the scenario, and choices."""
        several = len(self.bases) > 1
        return len(self.settings.axes) + several + sum(1 + most for most in self._most.values())

    @cached_property
    def _most(self) -> dict[str, int]:
        """By choice, the largest number of drawn values in an alternative."""
        return {
            table: max(sum(axis.is_drawn for axis in each.values()) for each in some.values())
            for table, some in self.settings.choices.items()
        }

    def values_of(self, run: int) -> dict[str, Scalar]:
        """What tells ``run`` apart, by name; the run must not belong to a search."""
        if self.settings.sampling == "grid":
            places = np.unravel_index(run // self.settings.repeats, self._shape)
            return self.values_at([
                at / (n - 1) if self._is_range(column) else (at + 0.5) / n
                for column, (at, n) in enumerate(
                    zip((int(place) for place in places), self._shape, strict=True)
                )
            ])  # fmt: skip
        return self.values_at(self._unit_points[run - self.searched].tolist())

    def values_at(self, point: Sequence[float]) -> dict[str, Scalar]:
        """What tells the run at a point of the unit cube apart, by name.

        The names are the axes, the scenario among several, the choices and the keys of the
        chosen alternatives.

        Raises:
            ScenarioError: an axis that the scenario, or the values of other keys, cannot give.
        """
        with self.named():
            return self._values_at(iter(point))

    @contextmanager
    def named(self) -> Iterator[None]:
        """Let refusals begin with the campaign's name."""
        try:
            yield
        except ScenarioError as error:
            raise ScenarioError(f"campaign {self.settings.name}: {error}") from None

    def _values_at(self, units: Iterator[float]) -> dict[str, Scalar]:
        drawn = {key: (axis, next(units)) for key, axis in self.settings.axes.items()}
        names: dict[str, Scalar] = {}
        base = self.base
        if len(self.bases) > 1:
            names[SCENARIO] = _one_of(list(self.bases), next(units))
            base = self.bases[str(names[SCENARIO])]
        for table, alternatives in self.settings.choices.items():
            names[table] = _one_of(base.possible(alternatives), next(units, 0.0))
            spare = [next(units, 0.0) for _ in range(self._most[table])]
            for key, axis in alternatives[str(names[table])].items():
                drawn[f"{table}.{key}"] = axis, spare.pop(0) if axis.is_drawn else 0.0
        values = {key: base.drawn(key, axis, unit) for key, (axis, unit) in drawn.items()}
        for key, (axis, _) in drawn.items():
            if axis.others:
                values[key] = base.depending(key, axis, values)
        return names | values

    @property
    def samples(self) -> Iterator[tuple[float, ...]]:
        """Points at the begin of every axis: each scenario with each alternative once."""
        several, place = int(len(self.bases) > 1), len(self.settings.axes)
        for number in range(len(self.bases)):
            begin = [0.0] * self.dimensions
            if several:
                begin[place] = (number + 0.5) / len(self.bases)
            at = place + several
            if not self.settings.choices:
                yield tuple(begin)
            for table, alternatives in self.settings.choices.items():
                for choice in range(len(alternatives)):
                    point = list(begin)
                    point[at] = (choice + 0.5) / len(alternatives)
                    yield tuple(point)
                at += 1 + self._most[table]

    def base_of(self, values: Mapping[str, Scalar]) -> Base:
        """The scenario of a run with these ``values``."""
        return self.bases[str(values[SCENARIO])] if len(self.bases) > 1 else self.base

    def seed_of(self, run: int) -> int:
        """The scenario's seed in ``run``, where neither settings nor axes say it."""
        word = np.random.SeedSequence([self.settings.seed, run]).generate_state(1, np.uint32)
        return int(word[0])

    def changes_of(self, run: int, values: dict[str, Scalar] | None = None) -> dict[str, Scalar]:
        """The value of every key specific to ``run``, numbered tables in their order.

        A search passes ``values``, the chosen values of the axes.
        """
        values = self.values_of(run) if values is None else values
        own = {key: value for key, value in values.items() if key in self.settings.keys}
        own = dict(sorted(own.items(), key=lambda each: _number_of_table(each[0])))
        return own if self._has_seed else {**own, "seed": self.seed_of(run)}

    def scenario_of(self, run: int) -> Scenario:
        """The scenario of ``run``, which must not belong to a search; see ``scenario_with``."""
        values = self.values_of(run)
        return self.base_of(values).scenario_with(self.changes_of(run, values))

    def __getstate__(self) -> dict[str, Any]:
        """Fields only, without cached properties."""
        return {"settings": self.settings, "bases": self.bases}

    @cached_property
    def _has_seed(self) -> bool:
        return "seed" in self.settings.keys or "seed" in self.settings.settings

    def _is_range(self, column: int) -> bool:
        """Whether a column of the grid is of an axis with points."""
        axes = list(self.settings.axes.values())
        return column < len(axes) and axes[column].values is None

    @cached_property
    def _shape(self) -> tuple[int, ...]:
        several = [len(self.bases)] if len(self.bases) > 1 else []
        return (
            *(len(axis.values or ()) or axis.points or 0 for axis in self.settings.axes.values()),
            *several,
            *(len(alternatives) for alternatives in self.settings.choices.values()),
        )

    @cached_property
    def _unit_points(self) -> FloatArray:
        """(runs, ``dimensions``) in [0, 1)."""
        runs, dimensions = self.settings.runs or 0, self.dimensions
        draw = np.random.default_rng(self.settings.seed)
        if dimensions == 0:
            return np.empty((runs, 0))
        if self.settings.sampling == "random":
            return draw.random((runs, dimensions))
        if self.settings.sampling == "latin-hypercube":
            return np.asarray(qmc.LatinHypercube(dimensions, seed=draw).random(runs))
        with warnings.catch_warnings(action="ignore"):  # about a number that is no power of two
            return np.asarray(qmc.Sobol(dimensions, seed=draw).random(runs))


def _one_of(names: list[str], unit: float) -> str:
    return names[min(int(unit * len(names)), len(names) - 1)]


def _number_of_table(key: str) -> int:
    """The number of a fault or disturbance in ``key``; a new table must follow the others."""
    name, _, own = key.partition(".")
    number = own.partition(".")[0]
    return int(number) if name in LISTS and number.isdecimal() else -1


def plan(settings: CampaignSettings) -> Plan:
    """A campaign with its scenarios; a run of each scenario and of each alternative is checked.

    Raises:
        ScenarioError: unknown scenario, unknown key of an axis or setting, or too many runs.
    """
    made = Plan(settings, {name: Base(settings, written(name)) for name in settings.scenario})
    if made.runs > MOST_RUNS:
        raise ScenarioError(
            f"campaign {settings.name}: {made.runs} runs; must be at most {MOST_RUNS}"
        )
    for point in made.samples:
        values = made.values_at(point)
        with made.named():
            made.base_of(values).scenario_with(made.changes_of(0, values))
    return made
