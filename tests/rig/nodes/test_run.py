"""Two processes: the same bytes as one, and no way of ending them that loses a tick or hangs."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import can
import pytest

from tests.helpers import DBC, record, rig, start

FILES = ["bus.log", "report.png", "run.json", "signals.csv"]
HEADER = (
    "time_s,reference_mps2,dstar_mps2,error_mps2,torque_nm,force_difference_n,"
    "fault_estimate_mps2,mode"
)
LONG = ["--set", "duration_s=2000"]


def wait_for(condition):
    """The first true value of ``condition()``; never hangs."""
    deadline = time.monotonic() + 60.0
    while not (found := condition()):
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.02)
    return found


def lines_of(log):
    return log.read_text().count("\n") if log.exists() else 0


def nodes_of(run):
    """Process ids of the run's nodes by name."""
    found = {}
    for task in Path(f"/proc/{run.pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            words = Path(f"/proc/{child}/cmdline").read_text().split("\0")
            if "can_rig" in words:
                found[words[words.index("can_rig") + 1]] = int(child)
    return found


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.fixture
def running(tmp_path):
    """A long run past its first ticks, its log and its two nodes."""
    log = tmp_path / "run" / "bus.log"
    process = start("run", "thesis-step", *LONG, "--out", log.parent)
    wait_for(lambda: lines_of(log) > 500 or process.poll() is not None)
    nodes = nodes_of(process)
    assert set(nodes) == {"plant", "controller"}
    yield process, log, nodes
    for pid in nodes.values():
        if alive(pid):
            os.kill(pid, signal.SIGKILL)
    process.kill()
    process.communicate()


def whole_ticks(log):
    """Ticks on disk, after checking that they are all there, in order and complete."""
    frames = list(can.LogReader(log))
    ticks = len(frames) // 5
    ids = [0x100, 0x101, 0x110, 0x111, 0x120]
    for at, frame in enumerate(frames[: 5 * ticks]):
        assert frame.arbitration_id == ids[at % 5]
        assert int.from_bytes(frame.data[2:4], "little") == (at // 5) & 0xFFFF
    return ticks


def folder_is_complete(folder, outcome):
    assert sorted(path.name for path in folder.iterdir()) == FILES
    ticks = whole_ticks(folder / "bus.log")
    rows = (folder / "signals.csv").read_text().splitlines()
    assert rows[0] == HEADER
    assert len(rows) - 1 - ticks in (0, 1)  # a tick cut short has a row too
    assert [row.split(",")[0] for row in rows[1:4]] == ["0", "0.001", "0.002"]
    summary = json.loads((folder / "run.json").read_text())
    assert outcome in summary["outcome"]
    assert (folder / "report.png").read_bytes().startswith(b"\x89PNG")
    return summary


def one_line(text):
    """The error among what a run printed beside its progress."""
    assert "Traceback" not in text
    (line,) = [line for line in text.splitlines() if "error:" in line]
    return line


# --- a whole run -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One short run of two processes with a fault in it."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    settings = ["duration_s=0.5", "fault.at_s=0.3", "seed=3", "noise.dstar_rms_mps2=0.001"]
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
    assert sorted(path.name for path in folder.iterdir()) == FILES
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


# --- by hand, in two terminals -----------------------------------------------------------------


@pytest.mark.parametrize("first", ["plant", "controller"])
def test_either_node_can_be_started_first(first, tmp_path):
    log = tmp_path / "bus.log"
    common = ["thesis-step", "--set", "duration_s=0.3", "--bus", f"local:{tmp_path / 'bus'}"]
    extra = {"plant": ["--log", log], "controller": []}
    second = "controller" if first == "plant" else "plant"
    early = start(first, *common, *extra[first])
    wait_for(lambda: (tmp_path / "bus").is_dir() and list((tmp_path / "bus").glob("*.node")))
    if first == "plant":
        wait_for(lambda: lines_of(log) or log.exists())
        time.sleep(0.3)  # it repeats its offer meanwhile
    late = start(second, *common, *extra[second])
    for process in (early, late):
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
        assert "300 of 300 ticks" in errors
    assert log.read_bytes() == record(tmp_path, "duration_s=0.3")[0].read_bytes()


@pytest.mark.parametrize(("node", "other"), [("plant", "controller"), ("controller", "plant")])
def test_a_node_that_stays_alone_says_whom_it_waited_for(node, other, tmp_path):
    bus = f"local:{tmp_path / 'bus'}"
    done = rig(node, "thesis-step", "--bus", bus, "--wait", "0.3")
    assert done.returncode == 3
    assert f"no frame from the {other} node for 0.3 s" in one_line(done.stderr)


# --- endings -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("victim", "left"), [("plant", "controller"), ("controller", "plant")])
def test_after_sigkill_the_other_ends_the_line_names_it_and_no_tick_is_lost(victim, left, running):
    process, log, nodes = running
    before = lines_of(log) // 5
    os.kill(nodes[victim], signal.SIGKILL)
    wait_for(lambda: not alive(nodes[left]))
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 3
    line = one_line(errors)
    assert f"the {victim} node was ended by SIGKILL" in line
    assert f"the {left} node" not in line
    folder_is_complete(log.parent, victim)
    assert whole_ticks(log) >= before


def test_by_hand_too_a_node_ends_after_its_partner_s_death(tmp_path):
    victim, other = "controller", "plant"
    log = tmp_path / "bus.log"
    common = ["thesis-step", *LONG, "--bus", f"local:{tmp_path / 'bus'}"]
    nodes = {"controller": start("controller", *common)}
    nodes["plant"] = start("plant", *common, "--log", log)
    wait_for(lambda: lines_of(log) > 500)
    nodes[victim].kill()
    _, errors = nodes[other].communicate(timeout=60)
    assert nodes[other].returncode == 3
    assert f"no frame from the {victim} node for 1 s" in one_line(errors)
    assert whole_ticks(log) > 100
    nodes[victim].communicate()


def test_a_node_that_hangs_is_named_and_does_not_stay(running):
    process, log, nodes = running
    victim = "controller"
    os.kill(nodes[victim], signal.SIGSTOP)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 3
    assert f"no frame from the {victim} node for 1 s" in one_line(errors)
    assert not any(map(alive, nodes.values()))
    folder_is_complete(log.parent, victim)


def test_a_node_that_is_stopped_for_less_than_the_watchdog_goes_on(running):
    process, log, nodes = running
    os.kill(nodes["controller"], signal.SIGSTOP)
    time.sleep(0.4)
    before = lines_of(log)
    os.kill(nodes["controller"], signal.SIGCONT)
    wait_for(lambda: lines_of(log) > before + 500)
    assert process.poll() is None


@pytest.mark.parametrize("how", ["the run", "its group, thrice"])
def test_ctrl_c_ends_both_cleanly_and_leaves_a_complete_folder(how, running):
    process, log, nodes = running
    if how == "the run":
        process.send_signal(signal.SIGINT)
    else:  # what a terminal does, and an impatient person
        for _ in range(3):
            os.killpg(process.pid, signal.SIGINT)
            time.sleep(0.2)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    for text in (output, errors):
        assert "Traceback" not in text
        assert "error" not in text.replace("|error|", "")
    assert not any(map(alive, nodes.values()))
    summary = folder_is_complete(log.parent, "interrupted")
    assert lines_of(log) == 5 * summary["ticks"]  # between two ticks


def test_ctrl_c_in_one_process(tmp_path):
    log = tmp_path / "run" / "bus.log"
    process = start("run", "thesis-step", *LONG, "--out", log.parent, "--in-process")
    wait_for(lambda: lines_of(log) > 500 or process.poll() is not None)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    summary = folder_is_complete(log.parent, "interrupted")
    assert lines_of(log) == 5 * summary["ticks"]


def test_ctrl_c_while_the_nodes_start_is_as_quiet_and_leaves_no_empty_folder(tmp_path):
    process = start("run", "thesis-step", *LONG, "--out", tmp_path / "run")
    wait_for((tmp_path / "run").is_dir)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors + output
    assert "error" not in errors
    assert not (tmp_path / "run").exists()


def test_ctrl_c_on_each_node_by_hand(tmp_path):
    log = tmp_path / "bus.log"
    common = ["thesis-step", *LONG, "--bus", f"local:{tmp_path / 'bus'}"]
    nodes = {"controller": start("controller", *common)}
    nodes["plant"] = start("plant", *common, "--log", log)
    try:
        wait_for(lambda: lines_of(log) > 500)
        for process in nodes.values():
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=60)
            assert process.returncode == 130
            assert "Traceback" not in errors
    finally:
        for process in nodes.values():
            process.kill()
            process.communicate()


def test_two_runs_at_once_do_not_meet(tmp_path):
    short = ["run", "thesis-step", "--set", "duration_s=0.2", "--out"]
    both = [start(*short, tmp_path / name) for name in ("a", "b")]
    for process in both:
        process.communicate(timeout=60)
        assert process.returncode == 0
    logs = {(tmp_path / name / "bus.log").read_bytes() for name in ("a", "b")}
    assert logs == {record(tmp_path, "duration_s=0.2")[0].read_bytes()}
