"""A CAN database of any format that cantools reads."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import cantools
from cantools.database.can import Database

from can_rig.errors import DbcError, one_line
from can_rig.frames.dbc import load_dbc

_HEAD_BYTES: Final = 4096
_LOOKS_LIKE: Final = {  # what the beginning of a file has in it, in the order of certainty
    "arxml": re.compile(rb"<AUTOSAR\b"),
    "kcd": re.compile(rb"<NetworkDefinition\b"),
    "sym": re.compile(rb"^\s*FormatVersion\s*=", re.M),
    "dbc": re.compile(rb"^\s*(VERSION|NS_|BS_|BU_|BO_|CM_)\b", re.M),
}
_BY_SUFFIX: Final = {".arxml": "arxml", ".kcd": "kcd", ".sym": "sym"}
_TOO_LARGE: Final = {  # places and lengths of six digits and more, for which cantools takes memory
    "arxml": re.compile(rb"<(?:LENGTH|FRAME-LENGTH|START-POSITION|BASE-TYPE-SIZE)>\s*(\d{6,})"),
    "kcd": re.compile(rb"(?:length|offset)\s*=\s*[\"'](\d{6,})"),
    "sym": re.compile(rb"(?:^(?:Len|DLC)\s*=|^(?:Var|Sig)\s*=[^\n]*?[\s,])(\d{6,})", re.M),
    "dbc": re.compile(
        rb"^\s*(?:SG_\s[^:\n]*:\s*(?:\d+\s*\|\s*)?|BO_\s+\d+\s+\w+\s*:\s*)(\d{6,})", re.M
    ),
}


def load_database(path: str | Path, strict: bool = True) -> Database:
    """Load a CAN database: DBC, ARXML, KCD or SYM, whatever its file is called.

    Args:
        path: the file.
        strict: whether signals must not overlap, and must fit into their messages.

    Raises:
        DbcError: it cannot be read or loaded.
    """
    kind = _format_of(Path(path))
    if kind == "dbc":
        return load_dbc(path, strict)
    try:
        encoding = "cp1252" if kind == "sym" else "utf-8"
        loaded = cantools.database.load_file(path, kind, encoding, strict=strict)
    except OSError as error:
        raise DbcError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # its readers of XML raise whatever a damaged file leads to
        raise DbcError(f"{path}: cannot be loaded: {one_line(error)}") from error
    if not isinstance(loaded, Database):
        raise DbcError(f"{path}: holds no CAN messages")
    return loaded


def _format_of(path: Path) -> str:
    """The format of a database by what is in it, or else by its suffix.

    Raises:
        DbcError: it cannot be read, or a length in it is beyond any frame.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise DbcError(f"{path}: cannot be read: {error.strerror}") from error
    head = text[:_HEAD_BYTES]
    by_suffix = _BY_SUFFIX.get(path.suffix.lower(), "dbc")
    found = next((kind for kind, mark in _LOOKS_LIKE.items() if mark.search(head)), by_suffix)
    if large := _TOO_LARGE[found].search(text):
        line = text.count(b"\n", 0, large.start(1)) + 1
        raise DbcError(
            f"{path}: line {line}: a place or length of {large[1][:20].decode()}; "
            "it must be below 100000"
        )
    return found
