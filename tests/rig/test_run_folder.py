"""The run folder where the disk has no room for it."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from can_rig.errors import RunFolderError
from can_rig.nodes import network_of
from can_rig.run_folder import LOG, REPORT, SIGNALS, SUMMARY, Outcome, finish
from can_rig.signals import Signals
from tests.rig.conftest import record


@pytest.mark.parametrize(
    ("writer", "name", "there"),
    [
        ((Path, "write_text"), SUMMARY, set()),
        ((Signals, "write_csv"), SIGNALS, {SUMMARY}),
        ((Figure, "savefig"), REPORT, {SUMMARY, SIGNALS}),
    ],
)
def test_a_full_disk_is_one_line_and_nothing_recorded_is_lost(
    writer: tuple[type, str],
    name: str,
    there: set[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    log, _, scenario = record(tmp_path, "duration_s=0.02", bus="virtual:full")
    folder = tmp_path / "r"
    folder.mkdir()
    shutil.copy(log, folder / LOG)
    monkeypatch.setattr(*writer, full)
    with pytest.raises(RunFolderError) as caught:
        finish(folder, scenario, network_of(scenario), Outcome("virtual:full"))
    assert str(caught.value) == (
        f"{folder / name}: cannot be written: No space left on device; "
        f"what was recorded is in {folder / LOG}"
    )
    assert {path.name for path in folder.iterdir()} == {LOG, *there}
    assert (folder / LOG).read_bytes() == log.read_bytes()
