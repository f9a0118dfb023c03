"""DBC files: where the shipped ones are, how one is loaded, and the attributes of its messages."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path

import cantools
from cantools.database.can import Database, Message

from can_rig.errors import DbcError
from can_rig.frames.dbc_advice import advice


@cache
def shipped_dbc(name: str) -> Path:
    """The DBC called ``name`` that comes with the package, or is in the checkout."""
    package = Path(str(files("can_rig")))
    folder = package / "dbc" if (package / "dbc").is_dir() else package.parent / "dbc"
    return folder / name


def load_dbc(path: str | Path, strict: bool = True) -> Database:
    """Load the DBC at ``path``.

    Args:
        path: the file.
        strict: whether signals must not overlap, and must fit into their messages.

    Raises:
        DbcError: it cannot be read, or is not a DBC.
    """
    try:
        loaded = cantools.database.load_file(path, database_format="dbc", strict=strict)
    except OSError as error:
        raise DbcError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # whatever a damaged file leads cantools to
        said = advice(Path(path).read_text("cp1252", "replace"), error)
        raise DbcError(f"{path}: not a DBC that can be loaded: {said}") from error
    if not isinstance(loaded, Database):
        raise DbcError(f"{path}: holds no CAN messages; it must be a DBC")
    return loaded


def attribute(message: Message, name: str) -> int | str | None:
    """The attribute of a message, as a word for an ENUM; None where the DBC does not set it."""
    found = message.dbc.attributes.get(name) if message.dbc else None
    if found is None or isinstance(found.value, float):
        return None
    choices = found.definition.choices
    if choices and isinstance(found.value, int):
        return str(choices[found.value]) if found.value in range(len(choices)) else None
    return found.value
