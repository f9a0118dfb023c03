"""The formats of logs, by the suffixes of their files."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from can_rig.errors import LogError

SUFFIXES: Final = (".log", ".asc", ".blf", ".trc", ".mf4")
COMPRESSED: Final = (".log", ".asc", ".trc")
"""The formats that may also be gzipped, with ``.gz`` after their suffix."""


def format_of(path: Path) -> str:
    """The format of ``path``: its suffix in lower case, without ``.gz``.

    Raises:
        LogError: the suffix is not one of a log.
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
