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
_MOST_BYTES: Final = 4096  # of a message: a container; J1939 has 1785
_SIZES: Final = {  # places and lengths, and the most that cantools deals with in bounded time
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
        (rb"(?<=[0-9])-([0-9]+)\s*[,;]", 1),  # values of a multiplexer, each of which is listed
    ),
}
_MOST_IDENTIFIER: Final = (1 << 29) - 1


def load_database(path: str | Path, strict: bool = True) -> Database:
    """Load a CAN database: DBC, ARXML, KCD or SYM, whatever its file is called.

    Args:
        path: the file.
        strict: whether signals must not overlap, and must fit into their messages.

    Raises:
        DbcError: it cannot be read or loaded.
    """
    kind = _format_of(Path(path))
    loaded = load_dbc(path, strict) if kind == "dbc" else _load(path, kind, strict)
    for message in loaded.messages:
        names = [message.name, *(signal.name for signal in message.signals)]
        if not all(isinstance(name, str) for name in names):
            raise DbcError(f"{path}: message 0x{message.frame_id:X} or a signal of it has no name")
        if not 0 <= message.frame_id <= _MOST_IDENTIFIER:
            raise DbcError(f"{path}: message {message.name} must have 11 or 29 bits of identifier")
    return loaded


def _load(path: str | Path, kind: str, strict: bool) -> Database:
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
    for pattern, units in _SIZES[found]:
        for size in re.finditer(pattern, text, re.M):
            if len(size[1]) > 9 or int(size[1]) > units * _MOST_BYTES:
                line = text.count(b"\n", 0, size.start(1)) + 1
                raise DbcError(
                    f"{path}: line {line}: a place, length or range of {size[1][:20].decode()}; it "
                    f"must be at most {units * _MOST_BYTES}"
                )
    return found
