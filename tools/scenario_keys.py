"""docs/scenario-keys.md: every key of a scenario, with the settings themselves as the source.

Keys, defaults and bounds come from the JSON schema that pydantic derives from the settings, units
from the suffix of the key. A meaning is the description of the field in the settings, where it has
one, and otherwise an entry of tools/scenario_keys.toml.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from can_rig.drawing.names import unit_of
from can_rig.scenario.settings import Scenario

MEANINGS = Path(__file__).with_name("scenario_keys.toml")
PAGE = Path(__file__).parents[1] / "docs" / "scenario-keys.md"
OTHER_UNITS = {"ticks": "ticks", "bitrate": "bit/s"}
HEADER = """\
# Scenario keys

<!-- Written by tools/scenario_keys from the settings; do not edit by hand. -->

Every key of a scenario file and of `--set KEY=VALUE`. [Scenarios](scenarios.md) explains how they
work together. An unknown key, a value of the wrong type or a value out of bounds is refused in one
line that names the key.
"""


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(TypeAdapter(Scenario).json_schema()), encoding="utf-8")


def page(schema: dict[str, Any]) -> str:
    """The page for the JSON schema of the settings.

    Raises:
        ValueError: a key has no meaning, or two, or a meaning has no key.
    """
    meanings = tomllib.loads(MEANINGS.read_text(encoding="utf-8"))
    text = [HEADER]
    shown: dict[str, str] = {}
    kinds = {kind: meanings.pop(kind) for kind in schema["$defs"] if kind in meanings}
    for section, kind, table in sections(schema):
        text.append(f"\n## {f'`[{section}]`' if section else 'Top level'}\n")
        explained = kinds.get(kind, {}) | meanings.pop(section or "top", {})
        if introduction := explained.pop("", ""):
            text.append(f"\n{introduction}\n")
        if section == "model":
            continue  # the keys of the plant once more
        rows = []
        for key, field in table.items():
            meaning = one_meaning(f"{section}.{key}", field, explained.pop(key, None))
            cells = (f"`{key}`", unit(key), default(field), allowed(field), meaning)
            rows.append(f"| {' | '.join(cells)} |\n")
        if explained:
            raise ValueError(f"{MEANINGS.name}: no key {section}.{next(iter(explained))}")
        first = shown.setdefault("".join(rows), section)
        if first != section:
            text.append(f"\nThe keys of `[{first}]`.\n")
            continue
        text.extend(
            ("\n| key | unit | default | allowed | meaning |\n|---|---|---|---|---|\n", *rows)
        )
    if meanings:
        raise ValueError(f"{MEANINGS.name}: no section {next(iter(meanings))}")
    return "".join(text)


def sections(schema: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Name, settings and keys of the top level, then of each table, then of the tables in it."""
    fields = {key: field for key, field in schema["properties"].items() if key != "name"}
    yield from _tables("", "Scenario", fields, schema["$defs"])


def _tables(
    section: str, kind: str, fields: dict[str, Any], definitions: dict[str, Any]
) -> Iterator[tuple[str, str, dict[str, Any]]]:
    yield section, kind, {key: field for key, field in fields.items() if _table(field) is None}
    for key, field in fields.items():
        table = _table(field)
        if table is not None and section != "model":  # the model has the plant's keys
            inner = table.split("/")[-1]
            name = f"{section}.{key}".lstrip(".")
            yield from _tables(name, inner, definitions[inner]["properties"], definitions)


def _table(field: dict[str, Any]) -> str | None:
    """Which table a key is, or a list of them; None: a value."""
    items = field.get("items")
    listed = items if isinstance(items, dict) else {}
    found: str | None = field.get("$ref", listed.get("$ref"))
    return found


def one_meaning(key: str, field: dict[str, Any], explained: str | None) -> str:
    """What ``key`` means, from the settings or from the file of meanings, but not from both."""
    described = field.get("description")
    if (described is None) == (explained is None):
        found = "no meaning" if described is None else "a meaning in the settings too"
        raise ValueError(f"{key}: has {found}; it must have one, there or in {MEANINGS.name}")
    return " ".join((described or explained or "").split()).replace("|", r"\|")


def unit(key: str) -> str:
    """The unit that the suffix of a key says; empty for a key without one."""
    return OTHER_UNITS.get(key.rpartition("_")[2]) or unit_of(key)


def default(field: dict[str, Any]) -> str:
    """The default as a scenario file would have it."""
    value = field.get("default")
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value}`"


def allowed(field: dict[str, Any]) -> str:
    """What a value may be: words, or a type with its bounds."""
    if "anyOf" in field:
        return " or ".join(allowed(one) for one in field["anyOf"] if one.get("type") != "null")
    if field.get("type") == "array":
        return f"list of {several(field['items'])}"
    if "const" in field:
        return f'`"{field["const"]}"`'
    if "enum" in field and len(field["enum"]) > 8:
        return f"one of {len(field['enum'])} words"
    if "enum" in field:
        return ", ".join(f'`"{word}"`' for word in field["enum"])
    bounds = [
        f"{sign} {number(field[name])}"
        for name, sign in (
            ("exclusiveMinimum", ">"),
            ("minimum", "≥"),
            ("maximum", "≤"),
            ("exclusiveMaximum", "<"),
        )
        if name in field
    ]
    words = {
        "integer": "whole number",
        "string": "text",
        "object": "table",
        "boolean": "true or false",
    }
    kind = words.get(field["type"], field["type"])
    return ", ".join((kind, *bounds))


def several(items: dict[str, Any]) -> str:
    """The permitted entries of a list, in the plural."""
    if not items:
        return "numbers or pairs"
    if "prefixItems" in items:
        return "pairs"
    one = allowed(items)
    if one.startswith("list"):
        return f"lists{one.removeprefix('list')}"
    kind, comma, bounds = one.partition(",")
    return f"{kind}s{comma}{bounds}"


def number(value: float) -> str:
    """A bound, short."""
    return str(value) if isinstance(value, int) else f"{value:g}"


if __name__ == "__main__":
    main()
