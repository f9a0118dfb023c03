"""TOML to a validated, frozen scenario: the only source of a run's defaults.

``settings`` declares the keys. Errors name the scenario and the key. A word may replace one number,
``latency_ticks = "from-bus"``: a ``Draft`` keeps the word, and ``assessment.resolve`` computes the
number from the rest of the scenario.
"""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, Final, get_type_hints

from pydantic import TypeAdapter, ValidationError

from can_rig.errors import ScenarioError
from can_rig.scenario.catalogue import shipped
from can_rig.scenario.plant_settings import (
    CAR,
    FMU,
    NUMBERS,
    OWN,
    SIGNALS,
    STATE_SPACE,
    TRANSFER_FUNCTIONS,
)
from can_rig.scenario.refusal import refusal
from can_rig.scenario.settings import Scenario
from can_rig.scenario.tables.changes import (
    FAULT,
    LISTS,
    change,
    require_kinds,
    require_own_numbers,
)
from can_rig.scenario.tables.numbers import FACTORED, POLYNOMIAL

FROM_BUS: Final = ("latency_ticks", "from-bus")
"""A key, and the allowed word in place of its number."""

ACTUATORS: Final = ("torque_actuator", "force_difference_actuator")
INSTEAD: Final = (
    ("lag_s", "natural_frequency_rad_per_s"),
    ("natural_frequency_rad_per_s", "lag_s"),
    *product(POLYNOMIAL, FACTORED),
    *product(FACTORED, POLYNOMIAL),
)
"""A key and the key that the first replaces: the two lags, the two forms of a transfer function."""
FILES: Final = (
    ("reference", "file", ""),
    ("drive", "file", ""),
    ("network", "dbc", ""),
    ("plant", "kind", FMU),
)
"""Keys with a file name, and the prefix of the name."""
LIMITS: Final = ("limit_", "rate_")
"""Prefixes of keys that actuators have and models of actuators lack."""

MOST_TABLES: Final = 128
"""Limit of the cache; runs of a campaign share most tables."""

_ENCODER: Final = json.JSONEncoder(default=str)
_ADAPTER: Final = TypeAdapter(Scenario)
_TABLES: Final = {
    key: TypeAdapter(kind) for key, kind in get_type_hints(Scenario, include_extras=True).items()
}


@dataclass(frozen=True)
class Draft:
    """A scenario as written: ``scenario`` holds the default in place of each word."""

    scenario: Scenario
    words: frozenset[tuple[str, str]] = frozenset()
    """The written words: ``FROM_BUS`` or none."""


def read(name: str, settings: Iterable[str] = ()) -> Draft:
    """The scenario ``name``, shipped or a path to a TOML file, with ``KEY=VALUE`` changes.

    Raises:
        ScenarioError: an unknown scenario, invalid TOML, an unknown key, a bad value.
    """
    file = written(name)
    require_own_numbers(file.name, file.values.get(FAULT))
    file = replace(file, values=with_changes(file, settings))
    made = changed(file)
    require_kinds(file.name, file.values)
    return made


@dataclass(frozen=True)
class Written:
    """A scenario's file content.

    Attributes:
        given: the user's word: the name of a shipped scenario, or a path.
        name: the scenario's name.
        values: the written keys, without defaults.
    """

    given: str
    name: str
    values: dict[str, Any]


def written(name: str) -> Written:
    """The file of the scenario ``name``, shipped or a path, before any check of keys.

    Raises:
        ScenarioError: an unknown scenario, or invalid TOML.
    """
    known = shipped()
    path = Path(name)
    if name in known:
        path = known[name]
    elif path.exists() and not path.is_file():
        raise ScenarioError(f"scenario {name}: not a file; must be a TOML file or a shipped one")
    elif not path.is_file():
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"shipped ones: {', '.join(known)}"
        raise ScenarioError(f"scenario {name}: no such scenario and no such file; {hint}")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ScenarioError(f"scenario {name}: not readable as TOML: {error}") from None
    for name_of_table, key, prefix in FILES:
        table = values.get(name_of_table)
        given = table.get(key) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(given, str) and given.startswith(prefix):
            # in a scenario relative to the scenario's file; in --set to the working directory
            file = given.removeprefix(prefix)
            table[key] = prefix + (str(path.parent / file) if file else "")
    return Written(name, path.stem, values)


def changed(file: Written, settings: Iterable[str] = ()) -> Draft:
    """A written scenario with ``KEY=VALUE`` changes.

    Raises:
        ScenarioError: an unknown key, a bad value.
    """
    values = with_changes(file, settings)
    if "name" in values:
        raise ScenarioError(
            f"scenario {file.given}: name: unknown key; a scenario is named by its file"
        )
    return draft(file.name, values)


def with_changes(file: Written, settings: Iterable[str] = ()) -> dict[str, Any]:
    """The written keys with ``KEY=VALUE`` changes, before any check.

    Raises:
        ScenarioError: an invalid change.
    """
    values: dict[str, Any] = _copied(file.values)
    for setting in settings:
        change(values, setting)
    return values


def _copied(value: Any) -> Any:
    """A deep copy of TOML's tables and lists, open to changes."""
    if isinstance(value, dict):
        return {key: _copied(each) for key, each in value.items()}
    return [_copied(each) for each in value] if isinstance(value, list) else value


def of_run(values: Mapping[str, Any], settings: Iterable[str] = ()) -> Draft:
    """The scenario in a run folder's ``run.json``, with ``KEY=VALUE`` changes.

    A model parameter equal to the plant's follows the plant again after a change, like in a
    scenario file without that key.

    Raises:
        ScenarioError: as ``draft``.
    """
    changed: dict[str, Any] = json.loads(json.dumps(values))
    plant, model = changed.get("plant"), changed.get("model")
    noise = changed.pop("noise", None)
    if isinstance(noise, dict) and isinstance(plant, dict):  # of a run folder of version 0.1
        plant["sensor"] = {"noise_mps2": noise.get("dstar_rms_mps2", 0.0)}
    if isinstance(plant, dict) and isinstance(model, dict):
        changed["model"] = _other_than(plant, model)
    for setting in settings:
        change(changed, setting)
    return draft(str(changed.get("name", "run")), changed)


def draft(name: str, values: Mapping[str, Any]) -> Draft:
    """A scenario from plain values; ``model`` copies the plant except for its written keys.

    The controller's model is linear: for a plant of one's own, the plant's numbers, or the thesis's
    car with the same parameters.

    Raises:
        ScenarioError: an unknown key, a bad value; the message names the key.
    """
    merged = {key: value for key, value in values.items() if key != "name"}
    plant, model = merged.get("plant", {}), merged.get("model", {})
    if isinstance(plant, Mapping) and isinstance(model, Mapping):
        merged["model"] = _believed(plant, model)
    single = [key for key in LISTS if isinstance(merged.get(key), Mapping)]
    for key in LISTS:
        if not isinstance(given := merged.get(key, []), list | Mapping):
            raise ScenarioError(f"scenario {name}: {key} = {given!r}: must be a table, or several")
        if key in single:
            merged[key] = [given]
    words = frozenset(pair for pair in (FROM_BUS,) if _take(merged, *pair))
    try:
        scenario = Scenario(name=name, **{key: _valid(key, each) for key, each in merged.items()})
    except (ValidationError, KeyError):  # in one table; the whole scenario's finding has the key
        try:
            scenario = _ADAPTER.validate_json(_json({"name": name, **merged}))
        except ValidationError as error:
            said = refusal(error, Scenario)
            for key in single:  # a single table has no number
                said = re.sub(f"^{key}\\.0", key, said)
            raise ScenarioError(f"scenario {name}: {said}") from None
    return Draft(scenario, words)


def _valid(key: str, value: Any) -> Any:
    """``value`` as a field of ``Scenario``: converted if a table or a list of tables."""
    return _table(key, _json(value)) if isinstance(value, Mapping | list) else value


@lru_cache(MOST_TABLES)
def _table(key: str, text: str) -> Any:
    """A validated table of a scenario; equal texts share one object.

    Raises:
        KeyError: an unknown key.
        ValidationError: a bad value.
    """
    return _TABLES[key].validate_json(text)


def _json(value: Any) -> str:
    """JSON text: strict JSON accepts tables for dataclasses and whole numbers for floats."""
    return _ENCODER.encode(value)


def _believed(plant: Mapping[str, Any], model: Mapping[str, Any]) -> dict[str, Any]:
    """``model``, completed by the plant's values, without keys that no model has.

    A plant of one's own passes on the linear plant that represents the class; ``limits`` holds the
    model's limits. An actuator's lag in ``model`` replaces every other lag of the plant's actuator;
    likewise for the form of a transfer function.
    """
    inherited = {k: v for k, v in plant.items() if k not in (*OWN, *SIGNALS)}
    if ":" in str(plant.get("kind")):
        by_numbers = TRANSFER_FUNCTIONS if plant.get("g1") or plant.get("g2") else CAR
        inherited["kind"] = STATE_SPACE if plant.get("a") else by_numbers
    if model.get("kind", inherited.get("kind")) != inherited.get("kind"):
        inherited = {k: v for k, v in inherited.items() if k not in NUMBERS}
    for key in ACTUATORS:
        if isinstance(own := inherited.get(key), Mapping):
            inherited[key] = {k: v for k, v in own.items() if not k.startswith(LIMITS)}
    believed = {**inherited, **model}
    for key in (*ACTUATORS, "sensor", "g1", "g2"):
        ours, theirs = inherited.get(key), model.get(key)
        if isinstance(ours, Mapping) and isinstance(theirs, Mapping):
            replaced = {other for own, other in INSTEAD if theirs.get(own) is not None}
            kept = {k: v for k, v in ours.items() if k not in replaced}
            believed[key] = {**kept, **theirs}
    return believed


def _other_than(plant: Mapping[str, Any], model: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of ``model`` that differ from the plant's, table by table."""
    other: dict[str, Any] = {}
    for key, value in model.items():
        of_plant = plant.get(key)
        if isinstance(value, Mapping) and isinstance(of_plant, Mapping):
            if inner := _other_than(of_plant, value):
                other[key] = inner
        elif key not in plant or of_plant != value:
            other[key] = value
    return other


def _take(values: dict[str, Any], key: str, word: str) -> bool:
    """Whether ``word`` stands at ``key``; remove the word then, leaving other tables untouched."""
    first, _, rest = key.partition(".")
    inner = values.get(first)
    if rest and isinstance(inner, Mapping):
        values[first] = copy = dict(inner)
        return _take(copy, rest, word)
    if inner != word:
        return False
    del values[first]
    return True
