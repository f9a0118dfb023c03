"""The end of a run: where the disk has no room for it, or nothing was recorded."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from can_rig.cli.run import closing_table
from can_rig.errors import RunFolderError
from can_rig.results.run_folder import LOG, REPORT, SIGNALS, SUMMARY, Outcome, finish
from can_rig.results.signals import Signals
from can_rig.scenario.build import network_of
from tests.helpers import asked, record


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


def test_a_bus_within_one_process_is_refused_for_two(tmp_path: Path) -> None:
    done = asked("run", "thesis-step", "--bus", "virtual:x", "--out", tmp_path / "r")
    assert done.returncode == 2
    assert done.stderr.startswith("error: bus 'virtual:x': stays within one process")
    assert "--in-process" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(("lines", "has_table"), [(0, False), (2, False), (5, True)])
def test_without_a_whole_tick_there_are_no_metrics(
    lines: int, has_table: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The offer of tick 0 that nobody answered is none."""
    log, _, scenario = record(tmp_path, "duration_s=0.02", bus="virtual:short")
    folder, outcome, network = tmp_path / "r", Outcome("virtual:short"), network_of(scenario)
    folder.mkdir()
    (folder / LOG).write_text("".join(log.read_text().splitlines(keepends=True)[:lines]))
    values = finish(folder, scenario, network, outcome)
    closing_table(scenario, values, outcome, folder)
    shown = capsys.readouterr().out
    assert ("false alarms" in shown) == has_table
    assert ("ticks/s" in shown) == has_table
    assert f"run folder  {folder}" in shown.replace("\n", "")
