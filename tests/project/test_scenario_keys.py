"""docs/scenario-keys.md says what the settings say."""

import copy
import re
from collections.abc import Iterator
from typing import Any

import pytest
import scenario_keys
from pydantic import TypeAdapter

from can_rig.scenario.settings import Scenario

SCHEMA: dict[str, Any] = TypeAdapter(Scenario).json_schema()


@pytest.fixture
def schema():
    return copy.deepcopy(SCHEMA)


def test_the_page_is_up_to_date():
    assert scenario_keys.page(SCHEMA) == scenario_keys.PAGE.read_text(encoding="utf-8"), (
        "the settings have changed: run tools/scenario_keys"
    )


def tables(section: str, values: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each table by its heading, with its own keys; ``model`` is that of ``plant`` again."""
    inner = {key: value for key, value in values.items() if isinstance(value, dict)}
    free = {key: inner.pop(key, {}) for key in ("parameters", "variables")}
    assert not any(free.values())
    no_values = {*inner, *free, "name", "disturbance", "sensor"}  # none by default
    yield section, {k: v for k, v in values.items() if k not in no_values}
    for key, table in inner.items():
        if key != "model":
            yield from tables(f"{section}.{key}".lstrip("."), table)


def test_it_has_every_key_of_a_scenario_with_its_default():
    text = scenario_keys.PAGE.read_text(encoding="utf-8")
    parts = dict(part.split("\n", 1) for part in text.split("\n## ")[1:])
    for section, table in tables("", Scenario("any").as_dict()):
        part = parts[f"`[{section}]`" if section else "Top level"]
        if same := re.search(r"^The keys of (`\[\S+\]`)\.$", part, re.MULTILINE):
            part = parts[same[1]]
        for key, value in table.items():
            shown = "not set" if value is None else f"`{value!r}`".replace("'", '"')
            shown = shown.lower() if isinstance(value, bool) else shown
            (row,) = (line for line in part.splitlines() if line.startswith(f"| `{key}` |"))
            assert row.split(" | ")[2] == shown


def test_a_key_without_a_meaning_is_refused(schema):
    schema["$defs"]["BusSettings"]["properties"]["termination_ohm"] = {"type": "number"}
    with pytest.raises(ValueError, match=r"bus\.termination_ohm: has no meaning"):
        scenario_keys.page(schema)


def test_two_meanings_are_refused(schema):
    schema["$defs"]["BusSettings"]["properties"]["bitrate"]["description"] = "Bits a second."
    with pytest.raises(ValueError, match=r"bus\.bitrate: has a meaning in the settings too"):
        scenario_keys.page(schema)


def test_a_meaning_without_a_key_is_refused(schema):
    del schema["$defs"]["BusSettings"]["properties"]["bitrate"]
    with pytest.raises(ValueError, match=r"no key bus\.bitrate"):
        scenario_keys.page(schema)


@pytest.mark.parametrize(
    ("field", "shown"),
    [({"type": "number", "exclusiveMinimum": 0.0}, "number, > 0"),
     ({"type": "integer", "minimum": 1, "maximum": 8}, "whole number, ≥ 1, ≤ 8"),
     ({"type": "number", "minimum": 1e-5, "exclusiveMaximum": 1.0}, "number, ≥ 1e-05, < 1"),
     ({"anyOf": [{"type": "number"}, {"type": "null"}]}, "number"),
     ({"anyOf": [{"type": "integer"}, {"const": "from-bus"}]}, 'whole number or `"from-bus"`'),
     ({"type": "array", "items": {"type": "number"}}, "list of numbers"),
     ({"type": "array", "items": {"type": "array", "items": {"type": "number"}}},
      "list of lists of numbers"),
     ({"type": "array", "items": {}}, "list of numbers or pairs"),
     ({"type": "boolean"}, "true or false"),
     ({"enum": ["a", "b"], "type": "string"}, '`"a"`, `"b"`')],
)  # fmt: skip
def test_bounds_are_shown(field, shown):
    assert scenario_keys.allowed(field) == shown


def test_the_longest_suffix_says_the_unit():
    assert scenario_keys.unit("torque_rate_nm_per_s") == "N m/s"
    assert scenario_keys.unit("frequency_rad_per_s") == "rad/s"
    assert scenario_keys.unit("alpha") == ""
