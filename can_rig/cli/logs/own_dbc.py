"""The DBC of a log that names none."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from can_rig.errors import RigError
from can_rig.frames.dbc import shipped_dbc
from can_rig.results.source import source_of

CAR: Final = "steer_by_wire.dbc"


def own_dbc(source: Path) -> Path:
    """The DBC of a run folder's scenario; otherwise that of the car."""
    if not source.is_dir():
        return shipped_dbc(CAR)
    try:
        return shipped_dbc(source_of(source, None, ()).scenario.dbc)
    except RigError:  # a run that was killed before its run.json
        return shipped_dbc(CAR)
