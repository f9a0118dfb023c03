"""From a campaign's keys to the settings of each of its runs, which its number alone decides."""

from __future__ import annotations

import math
import shlex
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy.stats import qmc

from can_rig.assessment.resolve import resolve
from can_rig.campaigns.settings import MOST_RUNS, AxisSettings, CampaignSettings, Scalar
from can_rig.errors import ScenarioError
from can_rig.scenario.loading import (
    LIMITS,
    Written,
    as_settings,
    linear_kind,
    model_follows,
    value_in,
    with_values,
    written,
)
from can_rig.scenario.plant_settings import SHORTEST_LAG_S
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import FloatArray

DIGITS: Final = 9
"""Significant digits of a drawn value: the run uses exactly the printed number."""

LAGS: Final = ("lag_s", "natural_frequency_rad_per_s")
"""Alternative keys of an actuator; each actuator has one key of the two."""

NOT_BELIEVED: Final = ("kind", "variant", "parameters", "friction")
"""Keys of ``plant`` that ``model`` lacks or need not keep."""


@dataclass(frozen=True)
class Plan:
    """A campaign ready to run.

    Attributes:
        settings: its keys.
        file: the scenario file.
    """

    settings: CampaignSettings
    file: Written

    @cached_property
    def base(self) -> Scenario:
        """The scenario with the campaign's settings, before any axis changes it."""
        return resolve(self.file.with_changes(self._common).draft)

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

    def values_of(self, run: int) -> dict[str, Scalar]:
        """The value of every axis in ``run``, which must not belong to a search."""
        axes = self.settings.axes
        if self.settings.sampling == "grid":
            places = np.unravel_index(run // self.settings.repeats, self._shape)
            grid = [values[int(at)] for values, at in zip(self._grid, places, strict=True)]
            return dict(zip(axes, grid, strict=True))
        return self.values_at(self._unit_points[run - self.searched].tolist())

    def values_at(self, point: Sequence[float]) -> dict[str, Scalar]:
        """The value of every axis at a point of the unit cube."""
        return {key: self._drawn(key, u) for key, u in zip(self.settings.axes, point, strict=True)}

    def seed_of(self, run: int) -> int:
        """The scenario's seed in ``run``, where neither settings nor axes say it."""
        word = np.random.SeedSequence([self.settings.seed, run]).generate_state(1, np.uint32)
        return int(word[0])

    def changes_of(self, run: int, values: dict[str, Scalar] | None = None) -> dict[str, Scalar]:
        """The value of every key specific to ``run``.

        A search passes ``values``, the chosen values of the axes.
        """
        values = self.values_of(run) if values is None else values
        return values if self._has_seed else {**values, "seed": self.seed_of(run)}

    def scenario_of(self, run: int) -> Scenario:
        """The scenario of ``run``, which must not belong to a search; see ``scenario_with``."""
        return self.scenario_with(self.changes_of(run))

    def scenario_with(self, changes: dict[str, Scalar]) -> Scenario:
        """The scenario of a run: the common settings, then these values.

        Raises:
            ScenarioError: the values are invalid.
        """
        of_model = {f"model.{key}": changes[f"plant.{key}"] for key in self._followed}
        if "model.kind" in of_model:
            plant = self._file_of_all.values.get("plant", {})
            of_model["model.kind"] = linear_kind({**plant, "kind": changes["plant.kind"]})
        return resolve(with_values(self._file_of_all.draft, {**of_model, **changes}))

    def command_with(self, changes: dict[str, Scalar]) -> str:
        """The command that repeats a run with these values, frames included."""
        words = ["can-rig", "run", self.file.given, "--in-process", "--allow-unstable"]
        for change in [*self._of_all, *as_settings(changes)]:
            words += ["--set", change]
        return shlex.join(words)

    def require_keys(self, changes: dict[str, Scalar]) -> None:
        """Refuse unknown keys, like ``--set``.

        Raises:
            ScenarioError: names the key.
        """
        resolve(self._file_of_all.with_changes(as_settings(changes)).draft)

    def __getstate__(self) -> dict[str, Any]:
        """Fields only, without cached properties."""
        return {"settings": self.settings, "file": self.file}

    @cached_property
    def _common(self) -> list[str]:
        return as_settings(self.settings.settings)

    @cached_property
    def _of_all(self) -> list[str]:
        """Changes common to all runs, applied before the axes."""
        return [*self._common, *self._kept_beliefs]

    @cached_property
    def _file_of_all(self) -> Written:
        return self.file.with_changes(self._of_all)

    @cached_property
    def _followed(self) -> list[str]:
        """Keys of the plant with an axis that the controller's model follows."""
        axes, values = self.settings.axes, self._file_of_all.values
        keys = [key.removeprefix("plant.") for key in axes if key.startswith("plant.")]
        return [key for key in keys if f"model.{key}" not in axes and model_follows(values, key)]

    @cached_property
    def _has_seed(self) -> bool:
        return "seed" in self.settings.axes or "seed" in self.settings.settings

    @cached_property
    def _kept_beliefs(self) -> list[str]:
        """Settings that keep what the controller believes where an axis changes the car."""
        if self.settings.redesign:
            return []
        kept: dict[str, Any] = {}
        for key in self.settings.axes:
            table, _, part = key.partition(".")
            last = part.rpartition(".")[2]
            if table != "plant" or part.startswith(NOT_BELIEVED) or last.startswith(LIMITS):
                continue
            if not has_key(self.base_values, f"model.{part}"):  # the run will say so
                continue
            stage = part.rpartition(".")[0]
            parts = [f"{stage}.{lag}" for lag in LAGS] if last in LAGS else [part]
            known = {each: value_in(self.base_values, f"model.{each}") for each in parts}
            if not any(known.values()) and last in LAGS:
                known = {f"{stage}.lag_s": 0.0}
            for each, value in known.items():
                if value is None and len(known) == 1:
                    raise ScenarioError(
                        f"campaign {self.settings.name}: axes.{key}: model.{part} must be set, so "
                        "that the controller's belief stays as it is, or redesign = true"
                    )
                if value or len(known) == 1:
                    kept[f"model.{each}"] = value
        return as_settings({k: v for k, v in kept.items() if k not in self.settings.axes})

    @cached_property
    def _shape(self) -> tuple[int, ...]:
        return tuple(len(values) for values in self._grid)

    @cached_property
    def _grid(self) -> list[list[Scalar]]:
        return [
            axis.values
            if axis.values is not None
            else [self._drawn(key, u) for u in np.linspace(0.0, 1.0, axis.points or 0).tolist()]
            for key, axis in self.settings.axes.items()
        ]

    @cached_property
    def _unit_points(self) -> FloatArray:
        """(runs, axes) in [0, 1)."""
        runs, axes = self.settings.runs or 0, len(self.settings.axes)
        draw = np.random.default_rng(self.settings.seed)
        if axes == 0:
            return np.empty((runs, 0))
        if self.settings.sampling == "random":
            return draw.random((runs, axes))
        if self.settings.sampling == "latin-hypercube":
            return np.asarray(qmc.LatinHypercube(axes, seed=draw).random(runs))
        with warnings.catch_warnings(action="ignore"):  # about a number that is no power of two
            return np.asarray(qmc.Sobol(axes, seed=draw).random(runs))

    @cached_property
    def base_values(self) -> dict[str, Any]:
        """Every key of ``base``."""
        return self.base.as_dict()

    def _drawn(self, key: str, unit: float) -> Scalar:
        """The value of an axis at a position in [0, 1]."""
        axis = self.settings.axes[key]
        if axis.values is not None:
            return axis.values[min(int(unit * len(axis.values)), len(axis.values) - 1)]
        low, high = self._ends(key, axis)
        if axis.scale == "log":
            value = math.exp(math.log(low) + unit * (math.log(high) - math.log(low)))
        else:
            value = low + unit * (high - low)
        if isinstance(value_in(self.base_values, key), int):
            if self.settings.sampling == "grid":
                return round(value)
            return min(math.floor(low + unit * (high + 1.0 - low)), math.floor(high))
        value = float(f"{value:.{DIGITS}g}")
        if key.endswith(".lag_s") and 0.0 < value < SHORTEST_LAG_S:  # shorter lags do not exist
            return 0.0 if value < 0.5 * SHORTEST_LAG_S else SHORTEST_LAG_S
        return value

    def _ends(self, key: str, axis: AxisSettings) -> tuple[float, float]:
        if axis.range is not None:
            return axis.range
        own = value_in(self.base_values, key)
        if not has_key(self.base_values, key):
            wrong = self.file.with_changes([*self._common, f"{key}=1"])
            resolve(wrong.draft)  # the error lists valid keys
        if isinstance(own, bool) or not isinstance(own, int | float) or own == 0.0:
            raise ScenarioError(
                f"campaign {self.settings.name}: axes.{key}.share = {axis.share}: {key} = {own!r} "
                "in the scenario; must be a number other than 0, or the axis have a range"
            )
        share = axis.share or 0.0
        low, high = own * (1.0 - share), own * (1.0 + share)
        return (low, high) if own > 0.0 else (high, low)


def has_key(scenario: dict[str, Any], key: str) -> bool:
    """Whether the key exists, set or not."""
    table = value_in(scenario, key.rpartition(".")[0])
    return isinstance(table, dict) and key.rpartition(".")[2] in table


def plan(settings: CampaignSettings) -> Plan:
    """A campaign with its scenario; the settings of the first run are checked.

    Raises:
        ScenarioError: unknown scenario, unknown key of an axis or setting, or too many runs.
    """
    made = Plan(settings, written(settings.scenario))
    if made.runs > MOST_RUNS:
        raise ScenarioError(
            f"campaign {settings.name}: {made.runs} runs; must be at most {MOST_RUNS}"
        )
    first = made.changes_of(made.searched)
    made.require_keys(first)
    made.scenario_with(first)
    return made
