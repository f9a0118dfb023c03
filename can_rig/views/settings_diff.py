"""Differences in the settings of two runs, key by key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from can_rig.scenario.settings import LISTS, Scenario

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
    values_a, values_b = _flat(a), _flat(b)
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


def _flat(scenario: Scenario) -> dict[str, Any]:
    return dict(_leaves("", scenario.as_dict()))


def _leaves(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(f"{prefix}{key}.", value)
        elif key in LISTS:
            numbered = {str(number): fault for number, fault in enumerate(value)}
            yield from _leaves(f"{prefix}{key}.", numbered)
        else:
            yield f"{prefix}{key}", value
