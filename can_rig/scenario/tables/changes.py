"""Keys with dots: writing ``KEY=VALUE`` into a scenario's tables, and reading from the tables.

``fault`` is a table or a list of tables: ``fault.1.at_s`` belongs to the second fault;
``fault.at_s`` and ``fault.0.at_s`` belong to a single fault. Likewise ``disturbance``.
"""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from can_rig.errors import ScenarioError
from can_rig.scenario.tables.fault import NUMBER, FaultSettings

FAULT: Final = "fault"
DISTURBANCE: Final = "disturbance"
LISTS: Final = (FAULT, DISTURBANCE)
"""Keys with a table or a list of tables."""

UNSET: Final = {key for key in NUMBER.values() if getattr(FaultSettings, key) is None}
"""Keys of faults without a default value."""

Changes = Mapping[str, Any]
"""Key → value; keys with dots, or tables within tables."""


def change(values: dict[str, Any], setting: str) -> None:
    """Apply one ``KEY=VALUE``; a value that is invalid TOML is a string, so quotes are optional."""
    key, equals, text = setting.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ScenarioError(f"--set {setting}: must be KEY=VALUE, as in plant.speed_mps=20")
    if any("\ud800" <= letter <= "\udfff" for letter in setting):
        raise ScenarioError(f"--set {setting!a}: must be text of this terminal's encoding")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    except ValueError:  # Python's limit on digits
        most = sys.get_int_max_str_digits()
        raise ScenarioError(f"--set {setting[:40]}...: must have at most {most} digits") from None
    table = values
    if parts[0] in LISTS and len(parts) > 1:
        table, parts = _of_list(values, setting, parts[0], parts[1:])
    for part in parts[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise ScenarioError(f"--set {setting}: {part} is a value and has no keys")
    table[parts[-1]] = value


def _of_list(
    values: dict[str, Any], setting: str, name: str, parts: list[str]
) -> tuple[dict[str, Any], list[str]]:
    """The table of the fault or disturbance in ``parts``, by number if several exist.

    The next free number appends a table.
    """
    listed = values.get(name) or {}
    faults = listed if isinstance(listed, list) else [listed]
    at, own = (int(parts[0]), parts[1:]) if parts[0].isdecimal() else (None, parts)
    if at is None and len(faults) == 1:
        at = 0
    known = ", ".join(f"{name}.{number}" for number in range(len(faults)))
    if at is None or at > len(faults) or not own:
        raise ScenarioError(f"--set {setting}: must be a key of {known} or {name}.{len(faults)}")
    faults = [*faults, {}] if at == len(faults) else faults
    if not isinstance(faults[at], dict):
        raise ScenarioError(f"--set {setting}: {name} is a value and has no keys")
    values[name] = faults if len(faults) > 1 else faults[0]
    return faults[at], own


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


def flat(changes: Changes, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Keys with dots, also from tables within tables."""
    for key, value in changes.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


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
    raise ScenarioError(f"{key} = {value!r}: must be a number, a string, true or false, or a list")


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
    faults = values.get(FAULT)
    for number, fault in enumerate(faults if isinstance(faults, list) else [faults]):
        if not isinstance(fault, Mapping) or not fault:
            continue
        where = f"{FAULT}.{number}" if isinstance(faults, list) else FAULT
        if "kind" not in fault:
            raise ScenarioError(
                f"scenario {name}: {where}.kind: must be set where {where}.{next(iter(fault))} is: "
                "'actuator-dead', 'frames-missing', 'sensor-biased', ..., or 'none'"
            )
    reference = values.get("reference")
    if isinstance(reference, Mapping) and "kind" not in reference:
        for key, kind in (("file", "csv"), ("lane_changes_s", "driver")):
            if reference.get(key):
                raise ScenarioError(
                    f"scenario {name}: reference.kind: must be {kind!r} where reference.{key} is"
                )


def require_own_numbers(name: str, faults: Any) -> None:
    """Refuse another kind's number in a fault, as written in the file ``name``.

    Raises:
        ScenarioError: the wrong key, and the right setting.
    """
    for number, fault in enumerate(faults if isinstance(faults, list) else [faults]):
        kind = fault.get("kind") if isinstance(fault, Mapping) else None
        own = NUMBER.get(kind) if isinstance(kind, str) else None
        if own is None or own in fault:
            continue
        for key in sorted(UNSET & fault.keys()):
            where = f"{FAULT}.{number}" if isinstance(faults, list) else FAULT
            raise ScenarioError(
                f"scenario {name}: {where}.{key} = {fault[key]!r}: says nothing of "
                f"{kind!r}; must be {where}.{own}"
            )
