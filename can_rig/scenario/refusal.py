"""pydantic's findings about settings as one line: ``key = value: must be ...``."""

import dataclasses
import difflib
import math
import re
from collections.abc import Sequence
from typing import Any, Final, get_type_hints

from pydantic import ValidationError

from can_rig.scenario.settings import keys, table_of

FEW: Final = 8
"""Words that a line can list."""

WORDS: Final = {
    "Input should": "must",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "a valid array": "a list",
    "an object": "a table",
    "a valid tuple": "a list",
}
"""pydantic's wording, and the rig's wording."""

FORMS: Final = {
    "TransferFunction": ", as { num = [...], den = [...] }",
    "FilterSettings": ", as { num = [...], den = [...] } or { sos = [[...]] }",
}
"""Tables in place of which numbers alone are often given, by their classes."""


def refusal(error: ValidationError, settings: type[Any]) -> str:
    """The first finding about ``settings``, the intended class.

    Findings of a ``__post_init__`` already read ``key = value: must be ...``, with the key within
    its table.
    """
    finding = error.errors()[0]
    location = [str(part) for part in finding["loc"]]
    key = ".".join(location)
    kind, message = finding["type"], finding["msg"].removeprefix("Value error, ")
    if kind == "unexpected_keyword_argument":
        return _unknown(settings, key, location)
    if kind == "json_invalid":
        key, message = "", "every name and text must be UTF-8"
    if kind in {"json_invalid", "value_error"}:
        return f"{key}.{message}" if key else message
    if kind == "dataclass_type":
        message = f"must be a table{FORMS.get(finding['ctx']['class_name'], '')}"
        if finding["ctx"]["class_name"] == "AxisSettings" and isinstance(finding["input"], list):
            message += f", as {{ values = {finding['input']!r} }}"
    if kind == "missing" and isinstance(finding["input"], dict):
        return f"{key}: must be set"
    if kind == "missing":  # of a pair
        return f"{'.'.join(location[:-1])} = {finding['input']!r}: must have one more value"
    if kind == "too_long":
        message = f"must have at most {finding['ctx']['max_length']} values"
    if kind == "bool_type" and location[-1] == "bool":  # of a value of any kind
        key, message = key.removesuffix(".bool"), "must be a number, a text, true or false"
    if kind == "literal_error":
        message = _one_of(finding["input"], finding["ctx"]["expected"])
    for theirs, ours in WORDS.items():
        message = message.replace(theirs, ours)
    if kind in {"float_parsing", "float_type", "int_parsing", "int_type"}:
        message += _as_toml(finding["input"])
    return f"{key} = {finding['input']!r}: {message}"


def _unknown(settings: type[Any], key: str, location: Sequence[str]) -> str:
    """What is wrong with a key that ``settings`` lacks."""
    if "." in location[-1]:
        return f'"{key}": must stand without quotation marks, as {key}'
    known = _keys(settings, location[:-1])
    near = [each for each in keys(settings) if each.endswith(f".{key}")]
    near += difflib.get_close_matches(location[-1], known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
    return f"{key}: unknown key; {hint}"


def _as_toml(value: Any) -> str:
    """TOML's spelling of a number in another notation: .5, 1., 1e3 with a comma."""
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        return ""
    return f", as {number:.15g}" if math.isfinite(number) else ""


def _one_of(value: Any, expected: str) -> str:
    """The expected words: all if few, otherwise those similar to ``value``."""
    words = re.findall("'([^']*)'", expected)
    if len(words) <= FEW:
        return f"must be {expected}"
    near = difflib.get_close_matches(str(value), words, n=3, cutoff=0.4)
    return (
        f"must be one of {len(words)} words, as {' or '.join(repr(w) for w in near or words[:3])}"
    )


def _keys(settings: type[Any], location: Sequence[str]) -> list[str]:
    """Key names of the table at ``location``; a scenario's name is no key of its file."""
    for part in location:  # numbers of a list and free names stay at the same settings
        settings = table_of(get_type_hints(settings).get(part)) or settings
    names = [field.name for field in dataclasses.fields(settings)]
    return [name for name in names if location or name != "name"]
