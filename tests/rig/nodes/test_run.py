"""A whole run of two processes: the bytes of a run in one process, and the folder."""

import gc
import subprocess
import sys

import pytest

from can_rig.nodes.ticks import without_garbage_pauses
from tests.helpers import DBC, record, rig, start
from tests.rig.nodes.running import FILES, folder_is_complete, one_line, whole_ticks


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One short run of two processes with a fault in it."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    settings = ["duration_s=0.5", "fault.at_s=0.3", "seed=3", "plant.sensor.noise_mps2=0.001"]
    arguments = [word for setting in settings for word in ("--set", setting)]
    return rig("run", "thesis-step", *arguments, "--out", folder), folder, settings


def test_two_processes_write_the_log_of_one_byte_for_byte(finished, tmp_path):
    done, folder, settings = finished
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    expected = record(tmp_path, *settings)[0].read_bytes()
    assert (folder / "bus.log").read_bytes() == expected


def test_the_run_folder_keeps_its_contract(finished):
    done, folder, _ = finished
    summary = folder_is_complete(folder, "complete")
    assert f"run folder  {folder}\n" in done.stdout
    assert summary["ticks"] == whole_ticks(folder / "bus.log") == 500
    assert summary["seed"] == summary["scenario"]["seed"] == 3
    assert summary["scenario"]["fault"]["at_s"] == 0.3
    assert summary["wall_s"] > 0.0
    assert {"python", "numpy", "numba", "python-can"} <= set(summary["versions"])
    assert "error_before_fault_mps2" in summary["metrics"]


def test_cantools_decodes_every_line(finished):
    _, folder, _ = finished
    with (folder / "bus.log").open() as log:
        decoded = subprocess.run(
            [sys.executable, "-m", "cantools", "decode", "--single-line",
             str(DBC / "steer_by_wire.dbc")],
            stdin=log, capture_output=True, text=True, check=True,
        ).stdout.splitlines()  # fmt: skip
    assert len(decoded) == 2500
    for at, name in enumerate(
        ["DSTAR_REFERENCE", "DSTAR_FEEDBACK", "STEER_TORQUE_CMD", "FORCE_DIFF_CMD"]
    ):
        assert all(f":: {name}(" in line for line in decoded[at::5])
    assert all("Mode: RUN" in line for line in decoded[4::5])


def test_an_existing_folder_is_an_error_and_force_replaces_it(finished):
    _, folder, _ = finished
    before = (folder / "bus.log").read_bytes()
    again = ["run", "thesis-step", "--set", "duration_s=0.01", "--in-process", "--out", folder]
    refused = rig(*again)
    assert refused.returncode == 2
    assert "there already" in one_line(refused.stderr)
    assert "--force" in refused.stderr
    assert (folder / "bus.log").read_bytes() == before
    stranger = folder / "notes.txt"
    stranger.write_text("mine")
    assert rig(*again, "--force").returncode == 0
    assert sorted(path.name for path in folder.iterdir()) == sorted([*FILES, "notes.txt"])
    assert stranger.read_text() == "mine"
    assert whole_ticks(folder / "bus.log") == 10


def test_a_run_that_cannot_start_replaces_nothing(tmp_path):
    short = ("run", "--out", tmp_path / "demo", "--in-process", "--set", "duration_s=0.01")
    assert rig(*short).returncode == 0
    before = (tmp_path / "demo/bus.log").read_bytes()
    failed = rig(*short, "--force", "--bus", "nosuchinterface:x")
    assert failed.returncode == 2
    assert (tmp_path / "demo/bus.log").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["demo"]
    assert rig(*short, "--force").returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["demo"]


def test_force_replaces_no_folder_that_is_not_a_run(tmp_path):
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "one.txt").write_text("dear")
    done = rig("run", "--out", tmp_path / "letters", "--force", "--set", "duration_s=0.01")
    assert done.returncode == 2
    assert "not a run folder" in one_line(done.stderr)
    assert (tmp_path / "letters" / "one.txt").read_text() == "dear"


def test_two_runs_at_once_do_not_meet(tmp_path):
    short = ["run", "thesis-step", "--set", "duration_s=0.2", "--out"]
    both = [start(*short, tmp_path / name) for name in ("a", "b")]
    for process in both:
        process.communicate(timeout=60)
        assert process.returncode == 0
    logs = {(tmp_path / name / "bus.log").read_bytes() for name in ("a", "b")}
    assert logs == {record(tmp_path, "duration_s=0.2")[0].read_bytes()}


@pytest.mark.parametrize("was_frozen", [False, True])
def test_what_a_command_keeps_the_collector_away_from_stays_so_after_a_run(was_frozen):
    (gc.freeze if was_frozen else gc.unfreeze)()
    try:
        with without_garbage_pauses():
            assert gc.get_freeze_count() > 0
        assert (gc.get_freeze_count() > 0) == was_frozen
    finally:
        gc.freeze()  # as the tests had it
