"""Changes of a scenario as a mapping of its keys, and as the ``KEY=VALUE`` of ``--set``."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from can_rig.errors import ScenarioError

Changes = Mapping[str, Any]
"""Key → value; keys with dots, or tables within tables."""


def as_settings(changes: Changes) -> list[str]:
    """``KEY=VALUE`` for each change, exact.

    Raises:
        ScenarioError: a value that TOML does not know.
    """
    return [f"{key}={toml_text(key, value)}" for key, value in flat(changes)]


def flat(changes: Changes, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Keys with dots, also of tables within tables."""
    for key, value in changes.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def toml_text(key: str, value: Any) -> str:
    """A value as TOML has it."""
    plain = value.item() if hasattr(value, "item") else value  # a number of numpy's
    if isinstance(plain, bool):
        return str(plain).lower()
    if isinstance(plain, int | float):
        return repr(plain)
    if isinstance(plain, str | Path):
        return json.dumps(str(plain))
    if isinstance(plain, list | tuple):
        return f"[{', '.join(toml_text(key, each) for each in plain)}]"
    raise ScenarioError(f"{key} = {value!r}: must be a number, a string, true or false, or a list")
