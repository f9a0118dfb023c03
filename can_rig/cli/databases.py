"""The databases for a log: the ``--dbc`` options, or the log's own database."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from cantools.database.can import Database

from can_rig.decoding.decode import Databases
from can_rig.errors import RigError
from can_rig.frames.databases import load_database, load_for, shipped_dbc
from can_rig.results.run_folder import LOG
from can_rig.results.source import source_of
from can_rig.scenario.build import dbc_of

CAR: Final = "steer_by_wire.dbc"


def databases_of(source: Path, named: Sequence[str], strict: bool) -> Databases:
    """The databases of --dbc, ``FILE`` or ``BUS=FILE``; the log's own without any.

    Raises:
        DbcError: one cannot be loaded.
    """
    if not named:
        return load_for(own_dbc(source), ()) if strict else load_database(own_dbc(source), False)
    found: list[tuple[str | None, Database]] = []
    for name in named:
        bus, equals, file = name.partition("=")
        if equals and not Path(name).exists():
            found.append((bus, load_database(file, strict)))
        else:
            found.append((None, load_database(name, strict)))
    return found


def own_dbc(source: Path) -> Path:
    """The DBC of a run folder's scenario, also where its log is named; else that of the car."""
    if not source.is_dir() and source.name.removesuffix(".gz") != LOG:
        return shipped_dbc(CAR)
    folder = source if source.is_dir() else source.parent
    try:
        return dbc_of(source_of(folder, None, ()).scenario)
    except RigError:  # a run killed before run.json was written
        return shipped_dbc(CAR)
