"""TOML to a validated, frozen scenario: the only source of a run's defaults.

``settings`` declares the keys. Errors name the scenario and the key. A word may replace one number,
``latency_ticks = "from-bus"``: the number is the worst case of the bus (``frames.bus_timing``).
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from can_rig.errors import RigError, ScenarioError, did_you_mean
from can_rig.frames.bus_timing import latency_ticks
from can_rig.scenario import shipped
from can_rig.scenario.build import network_of
from can_rig.scenario.controller_settings import LIBRARY
from can_rig.scenario.fault_settings import NUMBER, FaultSettings, key_of
from can_rig.scenario.own_class import is_class_path, seen_from
from can_rig.scenario.plant_settings import (
    CAR,
    FACTORED,
    FMU,
    NUMBERS,
    OWN,
    POLYNOMIAL,
    PUSHED_BY,
    SIGNALS,
    STATE_SPACE,
    TRANSFER_FUNCTIONS,
    flat,
)
from can_rig.scenario.refusal import refusal
from can_rig.scenario.settings import LISTS, Scenario

FAULT: Final = "fault"

UNSET: Final = {key for key in NUMBER.values() if getattr(FaultSettings, key) is None}
"""Keys of faults without a default value."""

Changes = Mapping[str, object]
"""Key → value; keys with dots, or tables within tables."""


def change(values: dict[str, Any], setting: str, where: str = "--set ") -> None:
    """Apply one ``KEY=VALUE``; a value that is invalid TOML is a string, so quotes are optional.

    ``where`` says whose change it is, and begins the line of a refusal.
    """
    key, equals, text = setting.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ScenarioError(f"{where}{setting}: must be KEY=VALUE, as in plant.speed_mps=20")
    if any("\ud800" <= letter <= "\udfff" for letter in setting):
        raise ScenarioError(f"{where}{setting!a}: must be text of this terminal's encoding")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    except ValueError:  # Python's limit on digits
        most = sys.get_int_max_str_digits()
        raise ScenarioError(f"{where}{setting[:40]}...: must have at most {most} digits") from None
    except RecursionError:
        raise ScenarioError(f"{where}{setting[:40]}...: lists must not be so deep") from None
    table = values
    if parts[0] in LISTS and len(parts) > 1:
        table, parts = _of_list(values, f"{where}{setting}", parts[0], parts[1:])
    for part in parts[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise ScenarioError(f"{where}{setting}: {part} is a value and has no keys")
    table[parts[-1]] = value


def _of_list(
    values: dict[str, Any], where: str, name: str, parts: list[str]
) -> tuple[dict[str, Any], list[str]]:
    """The table of the fault or disturbance in ``parts``, by number if several exist.

    The next free number appends a table.
    """
    listed = values.get(name) or {}
    tables = listed if isinstance(listed, list) else [listed]
    at, own = (int(parts[0]), parts[1:]) if parts[0].isdecimal() else (None, parts)
    if at is None and len(tables) == 1:
        at = 0
    known = ", ".join(f"{name}.{number}" for number in range(len(tables)))
    if at is None or at > len(tables) or not own:
        raise ScenarioError(f"{where}: must be a key of {known} or {name}.{len(tables)}")
    tables = [*tables, {}] if at == len(tables) else tables
    if not isinstance(tables[at], dict):
        raise ScenarioError(f"{where}: {name} is a value and has no keys")
    values[name] = tables if len(tables) > 1 else tables[0]
    return tables[at], own


def as_settings(changes: Changes) -> list[str]:
    """``KEY=VALUE`` for each change, exact.

    Raises:
        ScenarioError: not a mapping, or a value unknown to TOML.
    """
    if not isinstance(changes, Mapping):
        raise ScenarioError(
            f"changes = {changes!r}: must be a mapping of keys, as in {{'plant.speed_mps': 20.0}}"
        )
    return [f"{key}={toml_text(key, value)}" for key, value in flat(changes)]


def toml_text(key: str, value: Any) -> str:
    """A value in TOML's notation."""
    plain = value.item() if hasattr(value, "item") else value  # a number of numpy's
    if isinstance(plain, bool):
        return str(plain).lower()
    if isinstance(plain, int | float):
        return repr(plain)
    if isinstance(plain, str | Path):
        return json.dumps(str(plain))
    if isinstance(plain, list | tuple):
        return f"[{', '.join(toml_text(key, each) for each in plain)}]"
    if isinstance(plain, Mapping):
        pairs = (f"{json.dumps(name)} = {toml_text(key, each)}" for name, each in plain.items())
        return f"{{{', '.join(pairs)}}}"
    shown = " ".join(repr(value).split())
    raise ScenarioError(f"{key} = {shown}: must be a number, a string, true or false, or a list")


def value_in(values: Mapping[str, Any], key: str) -> Any:
    """The value of ``key`` in a scenario's tables; None for a missing key."""
    value: Any = values
    for at, part in enumerate(key.split(".")):
        if at == 1 and part.isdecimal() and key.partition(".")[0] in LISTS:
            listed = value if isinstance(value, list) else [value]
            value = listed[int(part)] if int(part) < len(listed) else None
        else:
            value = value.get(part) if isinstance(value, Mapping) else None
    return value


def require_kinds(name: str, values: Mapping[str, Any]) -> None:
    """Refuse keys in the scenario ``name`` without any effect.

    Such keys are keys of a fault without a kind, and a reference's file without its kind. Campaigns
    skip this check, because an axis may supply the missing key.

    Raises:
        ScenarioError: the wrong key, and the right setting.
    """
    for where, fault in _faults(values.get(FAULT)):
        if fault and "kind" not in fault:
            raise ScenarioError(
                f"scenario {name}: {where}.kind: must be set where {where}.{next(iter(fault))} is: "
                "'actuator-dead', 'frames-missing', 'sensor-biased', ..., or 'none'"
            )
    reference = values.get("reference")
    if isinstance(reference, Mapping) and "kind" not in reference:
        for key, kind in (
            ("file", "csv"), ("lane_changes_s", "driver"), ("samples_mps2", "samples"),
        ):  # fmt: skip
            if reference.get(key):
                raise ScenarioError(
                    f"scenario {name}: reference.kind: must be {kind!r} where reference.{key} is"
                )


def require_own_numbers(name: str, faults: Any) -> None:
    """Refuse another kind's number in a fault, as written in the file ``name``.

    Raises:
        ScenarioError: the wrong key, and the right setting.
    """
    for where, fault in _faults(faults):
        kind = fault.get("kind")
        own = key_of(kind, fault.get("channel", "")) if isinstance(kind, str) else ""
        for key in sorted(UNSET & fault.keys()) if own and own not in fault else ():
            raise ScenarioError(
                f"scenario {name}: {where}.{key} = {fault[key]!r}: has no effect for {kind!r}; "
                f"must be {where}.{own}"
            )


def _faults(written: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Key and table of each written fault, by number in a list."""
    several = isinstance(written, list)
    for number, fault in enumerate(written if several else [written]):
        if isinstance(fault, Mapping):
            yield (f"{FAULT}.{number}" if several else FAULT), fault


LATENCY, FROM_BUS = "latency_ticks", "from-bus"
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
    ("controller", "kind", FMU),
    ("controller", "kind", LIBRARY),
)
"""Keys with a file name, and the prefix of the name."""
CLASSES: Final = ("plant", "controller")
"""Tables whose ``kind`` may be a class."""
LIMITS: Final = ("limit_", "rate_")
"""Prefixes of keys that actuators have and models of actuators lack."""

_ADAPTER: Final = TypeAdapter(Scenario)


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

    def with_changes(self, settings: Iterable[str], where: str = "--set ") -> Written:
        """A copy with ``KEY=VALUE`` changes, before any check of keys; ``where``: see ``change``.

        Raises:
            ScenarioError: an invalid change.
        """
        values = deepcopy(self.values)
        for setting in settings:
            change(values, setting, where)
        return replace(self, values=values)

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario of the written keys.

        Raises:
            ScenarioError: as ``load_values``.
        """
        if "name" in self.values:
            raise ScenarioError(
                f"scenario {self.given}: name: unknown key; a scenario is named by its file"
            )
        return load_values(self.name, self.values)


def load(name: str, settings: Iterable[str] = ()) -> Scenario:
    """The scenario ``name``, shipped or a path to a TOML file, with ``KEY=VALUE`` changes.

    Raises:
        ScenarioError: an unknown scenario, invalid TOML; as ``load_values``.
    """
    file = written(name)
    require_own_numbers(file.name, file.values.get(FAULT))
    file = file.with_changes(settings)
    made = file.scenario
    require_kinds(file.name, file.values)
    return made


def written(name: str) -> Written:
    """The file of the scenario ``name``, shipped or a path, before any check of keys.

    Raises:
        ScenarioError: an unknown scenario, or invalid TOML.
    """
    path, values = toml_file("scenario", name, shipped())
    for name_of_table, key, prefix in FILES:
        table = values.get(name_of_table)
        given = table.get(key) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(given, str) and given.startswith(prefix):
            # in a scenario relative to the scenario's file; in --set to the working directory
            file = given.removeprefix(prefix)
            table[key] = prefix + (str(path.parent / file) if file else "")
    for table in map(values.get, CLASSES):
        if isinstance(table, dict) and is_class_path(kind := str(table.get("kind"))):
            table["kind"] = seen_from(path.parent, kind)
    return Written(name, path.stem, values)


def toml_file(what: str, name: str, known: Mapping[str, Path]) -> tuple[Path, dict[str, Any]]:
    """Path and values of the TOML file ``name``: one of the shipped files ``known``, or a path.

    Raises:
        ScenarioError: no such file, or invalid TOML; begins with ``what``, the noun, and ``name``.
    """
    path = known.get(name, Path(name))
    name = name or repr(name)  # an empty name would not be seen
    if path.exists() and not path.is_file():
        raise ScenarioError(f"{what} {name}: not a file; must be a TOML file or a shipped {what}")
    if not path.is_file():
        hint = did_you_mean(name, known, f"shipped ones: {', '.join(known)}")
        raise ScenarioError(f"{what} {name}: no such {what} and no such file; {hint}")
    try:
        return path, tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ScenarioError(f"{what} {name}: not readable as TOML: {error}") from None
    except ValueError:  # Python's limit on digits
        most = sys.get_int_max_str_digits()
        line = f"a number must have at most {most} digits"
        raise ScenarioError(f"{what} {name}: not readable as TOML: {line}") from None
    except RecursionError:
        raise ScenarioError(
            f"{what} {name}: not readable as TOML: lists must not be so deep"
        ) from None


def load_run(values: Mapping[str, Any], settings: Iterable[str] = ()) -> Scenario:
    """The scenario in a run folder's ``run.json``, with ``KEY=VALUE`` changes.

    A model parameter equal to the plant's follows the plant again after a change, like in a
    scenario file without that key.

    Raises:
        ScenarioError: as ``load_values``.
    """
    changed: dict[str, Any] = json.loads(json.dumps(values))
    plant, model = changed.get("plant"), changed.get("model")
    if isinstance(plant, dict) and isinstance(model, dict):
        changed["model"] = other_values(model, plant, unset=True)
    for setting in settings:
        change(changed, setting)
    return load_values(str(changed.get("name", "run")), changed)


def written_by(scenario: Scenario) -> dict[str, Any]:
    """The keys of a file that gives ``scenario``: every value that is not the default's.

    Raises:
        ScenarioError: no file gives the scenario: TOML cannot unset a value of the plant in the
            model.
    """
    values, usual = scenario.as_dict(), Scenario(scenario.name).as_dict()
    del values["name"]
    model = other_values(values["model"], values["plant"], unset=True)
    values["model"], usual["model"] = model, {}
    for name, key, prefix in FILES:
        file = values[name][key]
        if file and file.startswith(prefix):
            values[name][key] = prefix + str(Path(file.removeprefix(prefix)).resolve())
    for name in CLASSES:
        if is_class_path(kind := values[name]["kind"]):
            values[name]["kind"] = seen_from(Path.cwd(), kind)
    lists = {key: values.pop(key) for key in LISTS}
    for key, given in lists.items():
        tables = [given] if isinstance(given, dict) else given
        usual.pop(key)
        if listed := [keys_of(key, table) for table in tables]:
            values[key] = listed[0] if len(listed) == 1 else listed
    found = other_values(values, usual)
    if load_values(scenario.name, found) != load_values(scenario.name, values):
        raise ScenarioError(f"scenario {scenario.name}: model: has a lag that no file can unset")
    return found


def keys_of(name: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a fault, disturbance or sensor: the first, and all that differ from the usual."""
    first = next(iter(table))
    return {first: table[first], **other_values(table, asdict(LISTS[name]))}


def other_values(
    values: Mapping[str, Any], usual: Mapping[str, Any], unset: bool = False
) -> dict[str, Any]:
    """The values that differ from the usual ones, table by table; None is one if ``unset``."""
    other: dict[str, Any] = {}
    for key, value in values.items():
        of = usual.get(key)
        if isinstance(value, Mapping):
            if inner := other_values(value, of if isinstance(of, Mapping) else {}, unset):
                other[key] = inner
        elif (unset or value is not None) and value != of:
            other[key] = value
    return other


def load_values(name: str, values: Mapping[str, Any]) -> Scenario:
    """A scenario from plain values; ``model`` copies the plant except for its written keys.

    The controller's model is linear: for a plant of one's own, the plant's numbers, or the thesis's
    car with the same parameters.

    Raises:
        ScenarioError: an unknown key, a bad value, a bus too slow for ``from-bus``; the message
            names the key.
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
    latency = merged.get(LATENCY)
    if from_bus := latency == FROM_BUS:
        del merged[LATENCY]
    elif isinstance(latency, str):
        expected = f"must be a whole number of ticks, or {FROM_BUS!r}"
        raise ScenarioError(f"scenario {name}: {LATENCY} = {latency!r}: {expected}")
    try:  # strict JSON accepts tables for dataclasses and whole numbers for floats
        scenario = _ADAPTER.validate_json(json.dumps({"name": name, **merged}, default=str))
    except ValidationError as error:
        said = refusal(error, Scenario)
        for key in single:  # a single table has no number
            said = re.sub(f"^{key}\\.0", key, said)
        raise ScenarioError(f"scenario {name}: {said}") from None
    return _with_latency_of_bus(scenario) if from_bus else scenario


def _with_latency_of_bus(scenario: Scenario) -> Scenario:
    bus, where = scenario.bus, f'scenario {scenario.name}: {LATENCY} = "{FROM_BUS}"'
    try:
        ticks = latency_ticks(network_of(scenario), bus.bitrate, scenario.tick_s, bus.compute_s)
        return replace(scenario, latency_ticks=ticks)
    except ValidationError as error:  # more than a controller's table holds
        raise ScenarioError(f"{where}: {refusal(error, Scenario)}") from None
    except RigError as error:
        raise ScenarioError(f"{where}: {error}") from None


def linear_kind(plant: Mapping[str, Any]) -> str:
    """The kind of linear plant that ``model`` has beside this table ``plant``."""
    kind = str(plant.get("kind", CAR))
    if ":" not in kind:
        return kind
    tables = (plant.get("g1"), plant.get("g2"))
    given = (  # a whole scenario has tables without a number
        any(value is not None for value in each.values()) if isinstance(each, Mapping) else each
        for each in tables
    )
    by_numbers = TRANSFER_FUNCTIONS if any(given) else CAR
    return STATE_SPACE if plant.get("a") else by_numbers


def _believed(plant: Mapping[str, Any], model: Mapping[str, Any]) -> dict[str, Any]:
    """``model``, completed by the plant's values, without keys that no model has.

    A plant of one's own passes on the linear plant that represents the class; ``limits`` holds the
    model's limits. An actuator's lag in ``model`` replaces every other lag of the plant's actuator;
    likewise for the form of a transfer function.
    """
    inherited = {k: v for k, v in plant.items() if k not in (*OWN, *SIGNALS, *PUSHED_BY.values())}
    if ":" in str(plant.get("kind")):
        inherited["kind"] = linear_kind(plant)
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
