"""DBC files: locating the shipped files, loading, refusing, reading attributes of messages."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final

import cantools
from cantools.database.can import Database, Message

from can_rig.errors import DbcError, one_line

_SYNTAX: Final = re.compile(r"Invalid syntax at line (\d+), column (\d+)")
_MESSAGE: Final = re.compile(r"\b(?:in|of|to) message (\w+)|\bmessage (\w+)")
_OPEN: Final = re.compile(r"\s*(?:CM_|BA_|BA_DEF_\w*|VAL_|VAL_TABLE_|SG_MUL_VAL_|SIG_\w+)\s[^;]*")
_BEGINNING: Final = re.compile(r"\s*[A-Z]+\w*_\b")
_ADVICE: Final = {  # the text before the place, |, the text after the place: the change to make
    r".*\b(?:SG_|BO_ \d+)\s+\|\d": "a name must begin with a letter or an underscore",
    r".*\|\.\d": "a number must have a digit before its point, as in 0.5",
    r"\s*CM_\s+SG_\s+\d+\s*\|\"": "the name of the signal is missing before its comment",
    r"\s*CM_\s+\|\d": "BO_ must stand before the identifier of a message",
    r"\s*(?:CM_|BA_|VAL_)\b.*\|\w": "a word is misspelt, or its quotation marks are missing",
}
_OTHER: Final = "a DBC cannot have this here; the line must be mended or left out"
_SHOWN: Final = 40


@cache
def shipped_dbc(name: str) -> Path:
    """The DBC ``name`` from the package or the checkout."""
    package = Path(str(files("can_rig")))
    folder = package / "dbc" if (package / "dbc").is_dir() else package.parent / "dbc"
    return folder / name


def load_dbc(path: str | Path, strict: bool = True) -> Database:
    """Load the DBC at ``path``.

    Args:
        path: the file.
        strict: whether to refuse overlapping signals and signals larger than their message.

    Raises:
        DbcError: an unreadable file, or a file other than a DBC.
    """
    try:
        loaded = cantools.database.load_file(path, database_format="dbc", strict=strict)
    except OSError as error:
        raise DbcError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # any exception: a damaged file confuses cantools
        said = advice(Path(path).read_text("cp1252", "replace"), error)
        raise DbcError(f"{path}: not a DBC that can be loaded: {said}") from error
    if not isinstance(loaded, Database):
        raise DbcError(f"{path}: holds no CAN messages; it must be a DBC")
    return loaded


def advice(text: str, error: BaseException) -> str:
    """cantools's complaint about ``text``, a DBC, as one line that begins with the place."""
    said = one_line(error).removeprefix("DBC: ").strip('"')
    if syntax := _SYNTAX.search(said):
        number, column = int(syntax[1]), int(syntax[2])
        return _of_syntax(text.split("\n"), number, column)
    named = _MESSAGE.search(said)
    name = (named[1] or named[2]) if named else None
    place = re.search(rf"^\s*BO_\s+\d+\s+{name}\b", text, re.M) if name else None
    if place is None:
        return said
    line = text.count("\n", 0, place.end()) + 1
    if "is more than" in said:
        said += " It must be at most 2047; one of 29 bits at most 536870911, with 2147483648 added"
    return f"line {line}: {said}"


def _of_syntax(lines: list[str], number: int, column: int) -> str:
    line = lines[number - 1] if number <= len(lines) else ""
    before, here = line[: column - 1], line[column - 1 :].rstrip()
    last = next((n for n in range(number - 1, 0, -1) if lines[n - 1].strip()), 0)
    if not before.strip() and _BEGINNING.match(here) and last and _OPEN.fullmatch(lines[last - 1]):
        return f"line {last}: {lines[last - 1].strip()[:_SHOWN]!r} must end with a semicolon"
    what = next((a for mark, a in _ADVICE.items() if re.match(mark, f"{before}|{here}")), _OTHER)
    return f"line {number}, column {column}: {here[:_SHOWN]!r}: {what}"


def attribute(message: Message, name: str) -> int | str | None:
    """The attribute of a message, as a word for an ENUM; None for an unset attribute."""
    found = message.dbc.attributes.get(name) if message.dbc else None
    if found is None or isinstance(found.value, float):
        return None
    choices = found.definition.choices
    if choices and isinstance(found.value, int):
        return str(choices[found.value]) if found.value in range(len(choices)) else None
    return found.value
