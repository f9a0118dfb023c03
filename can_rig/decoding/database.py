"""A CAN database of any format that cantools reads."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cantools
from cantools.database.can import Database
from cantools.database.errors import Error

from can_rig.errors import DbcError, one_line
from can_rig.frames.dbc import load_dbc

_OTHER_FORMATS: Final = (".arxml", ".kcd", ".sym")


def load_database(path: str | Path, strict: bool = True) -> Database:
    """Load a DBC, or a CAN database of another format by its suffix (.arxml, .kcd, .sym).

    Args:
        path: the file.
        strict: whether signals must not overlap, and must fit into their messages.

    Raises:
        DbcError: it cannot be read or loaded.
    """
    if Path(path).suffix.lower() not in _OTHER_FORMATS:
        return load_dbc(path, strict)
    try:
        loaded = cantools.database.load_file(path, strict=strict)
    except OSError as error:
        raise DbcError(f"{path}: cannot be read: {error.strerror}") from error
    except (Error, ValueError, KeyError) as error:
        raise DbcError(f"{path}: cannot be loaded: {one_line(error)}") from error
    if not isinstance(loaded, Database):
        raise DbcError(f"{path}: holds no CAN messages")
    return loaded
