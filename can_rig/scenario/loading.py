"""A TOML scenario as a validated, frozen object: the one source of every default of a run.

What keys there are is declared in ``settings``. Errors name the scenario and the key.
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import sys
import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from can_rig.errors import RigError, ScenarioError
from can_rig.scenario.settings import BUILT_IN, Scenario
from firmware_model.errors import DesignError

FROM_BUS = "from-bus"  # what ``latency_ticks`` may be in a file
THRESHOLD = "fault_threshold_mps2"
FROM_BUDGET = "from-budget"  # what ``design.fault_threshold_mps2`` may be in a file


def shipped() -> dict[str, Path]:
    """Name → file of the scenarios that come with the package, sorted."""
    folder = Path(str(files("can_rig"))) / "scenario" / "shipped"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load(name: str, settings: Iterable[str] = ()) -> Scenario:
    """The scenario ``name``, a shipped one or a path to a TOML file, with ``KEY=VALUE`` changes.

    Raises:
        ScenarioError: no such scenario, not TOML, an unknown key, a bad value.
    """
    known = shipped()
    path = Path(name)
    if name in known:
        path = known[name]
    elif path.exists() and not path.is_file():
        raise ScenarioError(f"scenario {name}: not a file; a TOML file or a shipped one is right")
    elif not path.is_file():
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"shipped ones: {', '.join(known)}"
        raise ScenarioError(f"scenario {name}: no such scenario and no such file; {hint}")
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ScenarioError(f"scenario {name}: not readable as TOML: {error}") from None
    table = values.get("reference")
    if isinstance(table, dict) and isinstance(table.get("file"), str):
        # in a scenario relative to it, as everywhere else; in --set to the working directory
        table["file"] = str(path.parent / table["file"])
    for setting in settings:
        _change(values, setting)
    if "name" in values:
        raise ScenarioError(f"scenario {name}: name: unknown key; a scenario is named by its file")
    return from_dict(path.stem, values)


def from_run(values: Mapping[str, Any], settings: Iterable[str] = ()) -> Scenario:
    """The scenario that a run folder's ``run.json`` holds, with ``KEY=VALUE`` changes.

    A parameter that the controller believed as it was follows the plant's again when that is
    changed, as in a scenario file that does not name it.

    Raises:
        ScenarioError: as ``from_dict``.
    """
    changed: dict[str, Any] = json.loads(json.dumps(values))
    plant, model = changed.get("plant"), changed.get("model")
    if isinstance(plant, dict) and isinstance(model, dict):
        changed["model"] = {k: v for k, v in model.items() if k not in plant or plant[k] != v}
    for setting in settings:
        _change(changed, setting)
    return from_dict(str(changed.get("name", "run")), changed)


def from_dict(name: str, values: Mapping[str, Any]) -> Scenario:
    """A scenario from plain values; ``model`` is the plant's own but for the keys it names.

    What the controller believes in is linear: of a plant of one's own, the thesis's car with the
    same parameters.

    ``latency_ticks`` may be ``"from-bus"`` here, and ``design.fault_threshold_mps2``
    ``"from-budget"``; the scenario has the numbers that follow.

    Raises:
        ScenarioError: an unknown key, a bad value; the message names the key.
    """
    merged = {key: value for key, value in values.items() if key != "name"}
    plant, model = merged.get("plant", {}), merged.get("model", {})
    if isinstance(plant, Mapping) and isinstance(model, Mapping):
        linear = {"kind": BUILT_IN[0]} if ":" in str(plant.get("kind")) else {}
        merged["model"] = {**plant, **linear, **model}
    from_bus = merged.get("latency_ticks") == FROM_BUS
    if from_bus:
        merged["latency_ticks"] = 0  # until the rest, on which it depends, is known to be right
    tuning = merged.get("design")
    from_budget = isinstance(tuning, Mapping) and tuning.get(THRESHOLD) == FROM_BUDGET
    if isinstance(tuning, Mapping) and from_budget:
        merged["design"] = {key: value for key, value in tuning.items() if key != THRESHOLD}
    try:
        # As JSON, where strict still takes a table for a dataclass and a whole number for a float.
        scenario = _ADAPTER.validate_json(json.dumps({"name": name, **merged}, default=str))
    except ValidationError as error:
        raise ScenarioError(f"scenario {name}: {_first_line(error)}") from None
    except DesignError as error:
        raise ScenarioError(f"scenario {name}: plant: {error}") from None
    if from_bus:
        scenario = _with_latency_of_bus(scenario)
    return _with_threshold_of_budget(scenario) if from_budget else scenario


def _with_latency_of_bus(scenario: Scenario) -> Scenario:
    from can_rig.assessment.bus_timing.timing import latency_ticks  # noqa: PLC0415 (cantools: slow to import)
    from can_rig.scenario.build import network_of  # noqa: PLC0415 (imports this module)

    network, bus = network_of(scenario), scenario.bus
    try:
        ticks = latency_ticks(network, bus.bitrate, scenario.tick_s, bus.compute_s)
        return dataclasses.replace(scenario, latency_ticks=ticks)
    except (RigError, ValueError) as error:
        where = f'scenario {scenario.name}: latency_ticks = "{FROM_BUS}"'
        raise ScenarioError(f"{where}: {error}") from None


def _with_threshold_of_budget(scenario: Scenario) -> Scenario:
    from can_rig.assessment.threshold_budget import threshold_budget  # noqa: PLC0415 (imports this module)
    from can_rig.scenario.build import network_of  # noqa: PLC0415 (imports this module)

    least = dataclasses.replace(scenario.design, fault_threshold_mps2=sys.float_info.min)
    found = threshold_budget(dataclasses.replace(scenario, design=least), network_of(scenario))
    chosen = dataclasses.replace(
        scenario.design,
        fault_threshold_mps2=found.threshold,
        fault_threshold_share=max(scenario.design.fault_threshold_share, found.share),
    )
    return dataclasses.replace(scenario, design=chosen)


_ADAPTER = TypeAdapter(Scenario)


def _change(values: dict[str, Any], setting: str) -> None:
    """Apply one ``KEY=VALUE``; a value that is not TOML is a string, so quotes are optional."""
    key, equals, text = setting.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ScenarioError(f"--set {setting}: KEY=VALUE is right, as in plant.speed_mps=20")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    table = values
    for part in parts[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise ScenarioError(f"--set {setting}: {part} is a value and has no keys")
    table[parts[-1]] = value


def _first_line(error: ValidationError) -> str:
    """pydantic's first finding as ``key: what is wrong; what would be right``."""
    finding = error.errors()[0]
    location = [str(part) for part in finding["loc"]]
    key = ".".join(location)
    if finding["type"] == "unexpected_keyword_argument":
        near = difflib.get_close_matches(location[-1], _keys(location[:-1]), n=1, cutoff=0.5)
        known = ", ".join(_keys(location[:-1]))
        return f"{key}: unknown key; " + (f"did you mean {near[0]}?" if near else f"known: {known}")
    message = finding["msg"].removeprefix("Value error, ")
    if finding["type"] == "value_error":
        return f"{key}.{message}" if key else message
    return f"{key} = {finding['input']!r}: {message[0].lower()}{message[1:]}"


def _keys(location: list[str]) -> list[str]:
    """Key names of the table at ``location``."""
    kind: Any = Scenario
    for part in location:
        default = next(f.default_factory for f in dataclasses.fields(kind) if f.name == part)
        kind = default
    return [f.name for f in dataclasses.fields(kind) if f.name != "name"]
