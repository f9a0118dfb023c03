"""TOML to a validated, frozen scenario: the one source of every default of a run.

What keys there are is declared in ``settings``. Errors name the scenario and the key. One number
may be given as a word, ``latency_ticks = "from-bus"``: a ``Draft`` keeps it, and
``assessment.resolve`` puts the number in, which follows from the rest of the scenario.
"""

from __future__ import annotations

import difflib
import json
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
from can_rig.scenario.tables.changes import FAULT, change, require_kinds, require_own_numbers
from can_rig.scenario.tables.numbers import FACTORED, POLYNOMIAL

FROM_BUS: Final = ("latency_ticks", "from-bus")
"""A key, and the word that may stand there for its number."""

ACTUATORS: Final = ("torque_actuator", "force_difference_actuator")
INSTEAD: Final = (
    ("lag_s", "natural_frequency_rad_per_s"),
    ("natural_frequency_rad_per_s", "lag_s"),
    *product(POLYNOMIAL, FACTORED),
    *product(FACTORED, POLYNOMIAL),
)
"""A key, and one that it replaces: the two lags, the two forms of a transfer function."""
FILES: Final = (
    ("reference", "file", ""),
    ("drive", "file", ""),
    ("network", "dbc", ""),
    ("plant", "kind", FMU),
)
"""Keys that name a file, and what stands before its name."""
LIMITS: Final = ("limit_", "rate_")
"""Begins of the keys that an actuator has and a belief about it has not."""

MOST_TABLES: Final = 128
"""That are kept: runs of a campaign have most of theirs in common."""

_ENCODER: Final = json.JSONEncoder(default=str)
_ADAPTER: Final = TypeAdapter(Scenario)
_TABLES: Final = {
    key: TypeAdapter(kind) for key, kind in get_type_hints(Scenario, include_extras=True).items()
}


@dataclass(frozen=True)
class Draft:
    """A scenario as it is written: the default stands in ``scenario`` where a word is written."""

    scenario: Scenario
    words: frozenset[tuple[str, str]] = frozenset()
    """Which are written: ``FROM_BUS`` or none."""


def read(name: str, settings: Iterable[str] = ()) -> Draft:
    """The scenario ``name``, a shipped one or a path to a TOML file, with ``KEY=VALUE`` changes.

    Raises:
        ScenarioError: no such scenario, not TOML, an unknown key, a bad value.
    """
    file = written(name)
    require_own_numbers(file.name, file.values.get(FAULT))
    file = replace(file, values=with_changes(file, settings))
    made = changed(file)
    require_kinds(file.name, file.values)
    return made


@dataclass(frozen=True)
class Written:
    """A scenario as its file has it.

    Attributes:
        given: what names it: a shipped one, or a path.
        name: its own.
        values: its keys, without a default.
    """

    given: str
    name: str
    values: dict[str, Any]


def written(name: str) -> Written:
    """The file of the scenario ``name``, a shipped one or a path, before its keys are looked at.

    Raises:
        ScenarioError: no such scenario, or not TOML.
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
            # in a scenario relative to it, as everywhere else; in --set to the working directory
            file = given.removeprefix(prefix)
            table[key] = prefix + (str(path.parent / file) if file else "")
    return Written(name, path.stem, values)


def changed(file: Written, settings: Iterable[str] = ()) -> Draft:
    """A scenario that was written, with ``KEY=VALUE`` changes.

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
    """What is written, with ``KEY=VALUE`` changes, before its keys are looked at.

    Raises:
        ScenarioError: a change that is none.
    """
    values: dict[str, Any] = _copied(file.values)
    for setting in settings:
        change(values, setting)
    return values


def _copied(value: Any) -> Any:
    """Tables and lists of what TOML has, which a change goes into."""
    if isinstance(value, dict):
        return {key: _copied(each) for key, each in value.items()}
    return [_copied(each) for each in value] if isinstance(value, list) else value


def of_run(values: Mapping[str, Any], settings: Iterable[str] = ()) -> Draft:
    """The scenario that a run folder's ``run.json`` holds, with ``KEY=VALUE`` changes.

    A parameter that the controller believed as it was follows the plant's again when that is
    changed, as in a scenario file that does not name it.

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
    """A scenario from plain values; ``model`` is the plant's own but for the keys it names.

    What the controller believes in is linear: of a plant of one's own, what its numbers say, or
    the thesis's car with the same parameters.

    Raises:
        ScenarioError: an unknown key, a bad value; the message names the key.
    """
    merged = {key: value for key, value in values.items() if key != "name"}
    plant, model = merged.get("plant", {}), merged.get("model", {})
    if isinstance(plant, Mapping) and isinstance(model, Mapping):
        merged["model"] = _believed(plant, model)
    faults = merged.get("fault", [])
    several = isinstance(faults, list)
    if not isinstance(faults, list | Mapping):
        raise ScenarioError(f"scenario {name}: fault = {faults!r}: must be a table, or several")
    if isinstance(faults, Mapping):
        merged["fault"] = [faults]
    words = frozenset(pair for pair in (FROM_BUS,) if _take(merged, *pair))
    try:
        scenario = Scenario(name=name, **{key: _valid(key, each) for key, each in merged.items()})
    except (ValidationError, KeyError):  # in one table; of the whole, the finding has its key
        try:
            scenario = _ADAPTER.validate_json(_json({"name": name, **merged}))
        except ValidationError as error:
            said = refusal(error, Scenario)
            if not several:  # one table has no number
                said = said.replace(f"{FAULT}.0", FAULT, 1)
            raise ScenarioError(f"scenario {name}: {said}") from None
    return Draft(scenario, words)


def _valid(key: str, value: Any) -> Any:
    """``value`` as ``Scenario`` has it, if it is a table or a list of them."""
    return _table(key, _json(value)) if isinstance(value, Mapping | list) else value


@lru_cache(MOST_TABLES)
def _table(key: str, text: str) -> Any:
    """A table of a scenario: of one text one and the same.

    Raises:
        KeyError: there is no such key.
        ValidationError: a bad value.
    """
    return _TABLES[key].validate_json(text)


def _json(value: Any) -> str:
    """As JSON, where strict still takes a table for a dataclass and a whole number for a float."""
    return _ENCODER.encode(value)


def _believed(plant: Mapping[str, Any], model: Mapping[str, Any]) -> dict[str, Any]:
    """``model`` with what it does not name as the plant has it, but nothing that is no belief.

    Of a plant of one's own it is the linear plant that stands for it; limits are believed in
    ``limits``. An actuator's lag in ``model`` replaces any other of the plant's, and the form of a
    transfer function does so too.
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
    """The keys of ``model`` that are not as the plant has them, table by table."""
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
    """Whether ``word`` stands at ``key``; if so it is taken out, without touching other tables."""
    first, _, rest = key.partition(".")
    inner = values.get(first)
    if rest and isinstance(inner, Mapping):
        values[first] = copy = dict(inner)
        return _take(copy, rest, word)
    if inner != word:
        return False
    del values[first]
    return True
