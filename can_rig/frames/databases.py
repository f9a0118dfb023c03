"""CAN databases: the shipped DBC files, and files in any format that cantools reads."""

import re
from collections import Counter
from collections.abc import Collection
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final

import cantools
from cantools.database.can import Database, Message
from cantools.database.errors import Error as DatabaseError

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
_TEXT: Final = re.compile(r'"((?:[^"\\]|\\.)*)(?:"|\Z)', re.S)
_STATEMENT: Final = re.compile(r"\n\s*(?:BO_|SG_|CM_|BA_\w*|VAL_\w*|SIG_\w+|SG_MUL_VAL_)\s")
_SHOWN: Final = 40
_UNUSED: Final = re.compile(r"unused VAL_ .*?VAL_ (\d+) (\w+)")


@cache
def shipped_dbc(name: str) -> Path:
    """The DBC ``name`` from the package or the checkout."""
    package = Path(str(files("can_rig")))
    folder = package / "dbc" if (package / "dbc").is_dir() else package.parent / "dbc"
    return folder / name


def load_dbc(path: str | Path) -> Database:
    """Load the DBC at ``path``.

    Raises:
        DbcError: an unreadable file, or a file other than a DBC.
    """
    return _load(path, "dbc", strict=True)


def advice(text: str, error: BaseException) -> str:
    """cantools's complaint about ``text``, a DBC, as one line that begins with the place."""
    said = one_line(error).removeprefix("DBC: ").strip('"')
    if syntax := _SYNTAX.search(said):
        number, column = int(syntax[1]), int(syntax[2])
        return _of_syntax(text.split("\n"), number, column)
    named = _MESSAGE.search(said)
    name = (named[1] or named[2]) if named else None
    begin = rf"BO_\s+\d+\s+{name}" if name else None
    if unused := _UNUSED.search(said):
        begin = rf"VAL_\s+{unused[1]}\s+{unused[2]}"
        said += "; the signal must be in the message, or the line be left out"
    place = re.search(rf"^\s*{begin}\b", text, re.M) if begin else None
    if place is None:
        return said
    line = text.count("\n", 0, place.end()) + 1
    if "is more than" in said:
        said += " It must be at most 2047; one of 29 bits at most 536870911, with 2147483648 added"
    return f"line {line}: {said}"


def _of_syntax(lines: list[str], number: int, column: int) -> str:
    line = lines[number - 1] if number <= len(lines) else ""
    before, here = line[: column - 1], line[column - 1 :].rstrip()
    for quoted in _TEXT.finditer("\n".join([*lines[: number - 1], before])):
        if _STATEMENT.search(quoted[1]):
            first = quoted.string.count("\n", 0, quoted.start())
            said = f"{lines[first].strip()[:_SHOWN]!r} must have quotation marks in pairs"
            return f"line {first + 1}: {said}"
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


_HEAD_BYTES: Final = 4096
_LOOKS_LIKE: Final = {  # typical text at the beginning of a file, in the order of certainty
    "arxml": re.compile(rb"<AUTOSAR\b"),
    "kcd": re.compile(rb"<NetworkDefinition\b"),
    "sym": re.compile(rb"^\s*FormatVersion\s*=", re.M),
    "dbc": re.compile(rb"^\s*(VERSION|NS_|BS_|BU_|BO_|CM_)\b", re.M),
}
_BY_SUFFIX: Final = {".arxml": "arxml", ".kcd": "kcd", ".sym": "sym"}
_MOST_BYTES: Final = 4096  # of a message: a container; J1939 has 1785
_SIZES: Final = {  # places and lengths; limits of cantools's bounded computing time
    "arxml": ((rb"<FRAME-LENGTH>\s*(\d+)", 1), (rb"<(?:LENGTH|START-POSITION)>\s*(\d+)", 8)),
    "kcd": (
        (rb"<Message\b[^>]*?\blength\s*=\s*[\"'](\d+)", 1),
        (rb"\b(?:length|offset)\s*=\s*[\"'](\d+)", 8),
    ),
    "sym": (
        (rb"^(?:Len|DLC)\s*=\s*(\d+)", 1),
        (rb"^Var\s*=\s*\S+\s+\w+\s+(\d+)", 8),
        (rb"^(?:Var\s*=\s*\S+\s+\w+\s+\d+,|Sig\s*=\s*\S+\s+\w+\s+)(\d+)", 8),
    ),
    "dbc": (
        (rb"^\s*BO_\s+\d+\s+\w+\s*:\s*(\d+)", 1),
        (rb"^\s*SG_\s[^:\n]*:\s*(\d+)", 8),
        (rb"^\s*SG_\s[^:\n]*:\s*\d+\s*\|\s*(\d+)", 8),
    ),
}
_MULTIPLEXED: Final = re.compile(rb"\bSG_MUL_VAL_\s[^;]*")
_RANGE: Final = re.compile(rb"(\d+)\s*-\s*(\d+)")
_MOST_LISTED: Final = 1 << 18  # multiplexer values, which cantools keeps in lists
_MOST_IDENTIFIER: Final = (1 << 29) - 1
_MOST_STANDARD: Final = (1 << 11) - 1
_EXTENDED_BIT: Final = 1 << 31
_IDENTIFIER: Final = re.compile(  # message identifiers, at every place in a DBC
    r"^(\s*(?:BO_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_|BO_TX_BU_|"
    r"(?:CM_|BA_\s+\"[^\"]*\")\s+(?:BO_|SG_))\s+)(\d{4,10})\b",
    re.M,
)
_MESSAGE_OR_SIGNAL: Final = re.compile(r"^\s*(?:BO_\s+(\d+)|SG_\s+(\w+))\b", re.M)
_VALUE_TABLE: Final = re.compile(r"^\s*VAL_\s+(\d+)\s+(\w+)(?:\s+-?\d+\s+\"[^\"]*\")*\s*;", re.M)


def load_database(path: str | Path, strict: bool = True) -> Database:
    """Load a CAN database: DBC, ARXML, KCD or SYM, under any file name.

    Args:
        path: the file.
        strict: whether to refuse overlapping signals, signals larger than their message, and, in a
            DBC, unmarked extended identifiers and value tables of unknown signals.

    Raises:
        DbcError: an unreadable or invalid file.
    """
    kind = _format_of(Path(path))
    loaded = _load(path, kind, strict, mended=not strict)
    for message in loaded.messages:
        names = [signal.name for signal in message.signals]
        if not all(isinstance(name, str) for name in (message.name, *names)):
            raise DbcError(f"{path}: message 0x{message.frame_id:X} or a signal of it has no name")
        if not 0 <= message.frame_id <= _MOST_IDENTIFIER:
            raise DbcError(f"{path}: message {message.name} must have 11 or 29 bits of identifier")
        if len(set(names)) < len(names):
            _tell_apart(message, strict)
    return loaded


def load_for(path: str | Path, names: Collection[str]) -> Database:
    """Load a database; only the messages in ``names`` must be sound.

    Raises:
        DbcError: an unreadable or invalid file, or overlapping or oversized signals in ``names``.
    """
    try:
        return load_database(path)
    except DbcError as error:
        try:
            loaded = load_database(path, strict=False)
        except DbcError:
            raise error from None
    for message in loaded.messages:
        if message.name in names:
            try:
                message.refresh(strict=True)
            except DatabaseError as error:
                raise DbcError(f"{path}: cannot be used: {one_line(error)}") from None
    return loaded


def _tell_apart(message: Message, strict: bool) -> None:
    """Append the start bit to every signal name used twice."""
    every = Counter(signal.name for signal in message.signals)
    for signal in message.signals:
        if every[signal.name] > 1 and not signal.is_multiplexer:
            signal.name = f"{signal.name}_{signal.start}"
    message.refresh(strict)


def _text_of(path: str | Path) -> str:
    """A DBC says no encoding: UTF-8 if its bytes are valid there, otherwise that of Windows."""
    try:
        return Path(path).read_text("utf-8-sig")
    except UnicodeDecodeError:
        return Path(path).read_text("cp1252", "replace")


def _load(path: str | Path, kind: str, strict: bool, mended: bool = False) -> Database:
    text, encoding = "", "cp1252" if kind == "sym" else "utf-8"
    try:
        if kind == "dbc":
            text = _text_of(path)
            text = _mended(text) if mended else text
            loaded = cantools.database.load_string(text, kind, strict=strict)
        else:
            loaded = cantools.database.load_file(path, kind, encoding, strict=strict)
    except OSError as error:
        raise DbcError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # a damaged file confuses cantools: any exception
        said = advice(text, error) if kind == "dbc" else one_line(error)
        raise DbcError(f"{path}: cannot be loaded as {kind.upper()}: {said}") from error
    assert isinstance(loaded, Database)  # each of these kinds holds CAN messages
    return loaded


def _mended(text: str) -> str:
    """A DBC with marked extended identifiers, without value tables of unknown signals."""

    def marked(found: re.Match[str]) -> str:
        identifier = int(found[2])
        if _MOST_STANDARD < identifier <= _MOST_IDENTIFIER:
            identifier |= _EXTENDED_BIT
        return f"{found[1]}{identifier}"

    text = _IDENTIFIER.sub(marked, text)
    message, signals = "", set()
    for found in _MESSAGE_OR_SIGNAL.finditer(text):
        message = found[1] or message
        signals.add((message, found[2]))
    return _VALUE_TABLE.sub(lambda v: v[0] if (v[1], v[2]) in signals else _lines_of(v[0]), text)


def _lines_of(text: str) -> str:
    return "\n" * text.count("\n")


def _format_of(path: Path) -> str:
    """The format of a database by its content, otherwise by its suffix."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise DbcError(f"{path}: cannot be read: {error.strerror}") from error
    head = text[:_HEAD_BYTES]
    by_suffix = _BY_SUFFIX.get(path.suffix.lower(), "dbc")
    found = next((kind for kind, mark in _LOOKS_LIKE.items() if mark.search(head)), by_suffix)
    for pattern, units in _SIZES[found]:
        for size in re.finditer(pattern, text, re.M):
            if len(size[1]) > 9 or int(size[1]) > units * _MOST_BYTES:
                raise DbcError(
                    f"{path}: line {_line(text, size.start(1))}: a place or length of "
                    f"{size[1][:20].decode()}; it must be at most {units * _MOST_BYTES}"
                )
    if found == "dbc":
        _require_few_values(path, text)
    return found


def _require_few_values(path: Path, text: bytes) -> None:
    listed = 0
    for statement in _MULTIPLEXED.finditer(text):
        for values in _RANGE.finditer(text, statement.start(), statement.end()):
            first, last = (int(digits[:10]) for digits in values.groups())
            listed += max(last - first + 1, 0)
            if listed > _MOST_LISTED or max(map(len, values.groups())) > 10:
                raise DbcError(
                    f"{path}: line {_line(text, values.start())}: with {first}-{last} the "
                    f"multiplexers have more than {_MOST_LISTED} values, which is the most"
                )


def _line(text: bytes, at: int) -> int:
    return text.count(b"\n", 0, at) + 1
