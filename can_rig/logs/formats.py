"""The formats of logs: the suffix decides for a file to write, the content for a file to read."""

from __future__ import annotations

import re
import zlib
from pathlib import Path
from typing import Final

from can_rig.errors import LogError

SUFFIXES: Final = (".log", ".asc", ".blf", ".trc", ".mf4", ".csv")
COMPRESSED: Final = (".log", ".asc", ".trc", ".csv")
"""Formats that gzip may compress; ``.gz`` follows the suffix."""

BUSMASTER: Final = "BUSMASTER"
MICROCHIP: Final = "Microchip"
"""Read-only formats that share the suffix of another format."""

_HEAD_BYTES: Final = 1 << 14
_GZIP: Final = 16 + zlib.MAX_WBITS
_BINARY: Final = {b"LOGG": ".blf", b"MDF     ": ".mf4", b"UnFinMF ": ".mf4"}
_TEXT: Final = {
    ".log": re.compile(rb"\s*\(\d+(\.\d*)?\)[ \t]+\S+[ \t]+[0-9A-Fa-f]+#"),
    ".trc": re.compile(rb"@ TEXT @ |\s*;(\$FILEVERSION|#{8})|(\s*;[^\n]*\n)*\s*1\)[ \t]+\d"),
    ".asc": re.compile(
        rb"\s*(//[^\n]*\s*)*(date[ \t]+\w|base[ \t]+(hex|dec)|begin[ \t]+triggerblock)", re.I
    ),
    ".csv": re.compile(rb"\W*time stamp,\s*id,\s*extended", re.I),
    MICROCHIP: re.compile(rb"\s*//-+\s*Microchip |\s*\d+;[RT]X;0x", re.I),
    BUSMASTER: re.compile(rb"\s*\*\*\*\s*[<\[A-Z]", re.I),
}


def format_of(path: Path) -> str:
    """The format of ``path`` by its name: its suffix in lower case, without ``.gz``.

    Raises:
        LogError: the suffix belongs to no log format.
    """
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    compressed = bool(suffixes) and suffixes[-1] == ".gz"
    if compressed:
        suffixes.pop()
    known = COMPRESSED if compressed else SUFFIXES
    if not suffixes or suffixes[-1] not in known:
        raise LogError(
            f"{path}: unknown log format; the suffix must be one of {', '.join(SUFFIXES)} "
            f"({', '.join(COMPRESSED)} may be followed by .gz)"
        )
    return suffixes[-1]


def format_in(path: Path) -> str:
    """The format of a log by its first bytes, or else by its name.

    Raises:
        LogError: neither tells, or the file is missing.
    """
    found = content_format(path)
    if found is None and not path.exists():
        raise LogError(f"{path}: there is no such file")
    return found or format_of(path)


def content_format(path: Path) -> str | None:
    """The format of a log by its first bytes; None: the bytes fit no format."""
    if not path.is_file():  # a pipe is read once
        return None
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        if head[:2] == b"\x1f\x8b":
            head = zlib.decompressobj(_GZIP).decompress(head, _HEAD_BYTES)
    except (OSError, zlib.error):
        return None  # the reader reports the error
    binary = next((kind for mark, kind in _BINARY.items() if head.startswith(mark)), None)
    return binary or next((kind for kind, mark in _TEXT.items() if mark.match(head)), None)
