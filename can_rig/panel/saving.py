"""Saving a run, with every fault and reference change from the panel, as a repeatable scenario."""

from __future__ import annotations

import os
import re
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import tomli_w

from can_rig.errors import RigError
from can_rig.files import atomic
from can_rig.nodes.operating import done, touches
from can_rig.panel.session import Session
from can_rig.results.run_folder import log_of
from can_rig.results.signals import read_signals
from can_rig.results.source import reference_csv, source_of
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.loading import written

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def save(session: Session, name: str) -> Path:
    """Write the scenario that repeats the last run, ``NAME.toml`` in the working directory.

    A changed reference goes into a file beside the scenario, tick by tick.

    Raises:
        RigError: no run has ended, the name is invalid, the file exists or cannot be written.
    """
    if session.running or session.folder is None:
        raise RigError("no run has ended yet; what was done is saved afterwards")
    if not NAME.fullmatch(name):
        raise RigError(
            f"{name!r}: must be letters, digits, - and _, and begin with one of the first"
        )
    path, folder = Path(f"{name}.toml"), Path(session.folder)
    for each in (path, path.with_suffix(".csv")):
        if os.path.lexists(each):
            raise RigError(f"{each}: exists already; choose another name")
    source = source_of(folder, None, ())
    network = network_of(source.scenario)
    what = done(source.scenario, touches(source.frames(), network))
    values = written(session.name).with_changes(session.settings).values
    values["fault"] = [_keys(fault) for fault in what.scenario.faults]
    reference = path.with_suffix(".csv")
    if what.moved:
        values["reference"] = {"kind": "csv", "file": reference.name}
    with ExitStack() as both:  # both files or neither
        part = both.enter_context(atomic(path, force=False))
        part.write_text(f"# What was done in {folder}.\n\n{tomli_w.dumps(values)}", "utf-8")
        if what.moved:
            part = both.enter_context(atomic(reference, force=False))
            moved = read_signals(log_of(folder), network, session.scenario.tick_s)
            with part.open("w", encoding="utf-8", newline="\n") as file:
                file.writelines(reference_csv(moved))
    return path


def _keys(fault: FaultSettings) -> dict[str, Any]:
    """The scenario keys of ``fault``."""
    usual = asdict(FaultSettings())
    its = {key: value for key, value in asdict(fault).items() if value != usual[key]}
    return {"kind": fault.kind, "at_s": fault.at_s, **its}
