"""A whole run of two processes: the bytes of a run in one process, and the folder."""

import gc

import pytest

from can_rig.nodes.ticks import without_garbage_pauses
from tests.helpers import asked, record, sets, start
from tests.rig.nodes.running import folder_is_complete, whole_ticks

pytestmark = pytest.mark.reports


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One short run of two processes with a fault in it."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    settings = ["duration_s=0.5", "fault.at_s=0.3", "seed=3", "plant.sensor.noise_mps2=0.001"]
    return asked("run", "thesis-step", *sets(*settings), "--out", folder), folder, settings


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
