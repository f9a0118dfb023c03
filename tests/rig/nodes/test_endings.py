"""No way of ending a run of two processes loses a tick, hangs, or leaves a node behind."""

import os
import re
import signal
import time
from pathlib import Path

import pytest

from can_rig.errors import SilentNodeError
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.processes import in_another_process
from tests.helpers import rig, start
from tests.processes import wait_for
from tests.rig.nodes.running import (
    LONG,
    alive,
    folder_is_complete,
    lines_of,
    one_line,
    running,
    summary_of,
    whole_ticks,
)

pytestmark = pytest.mark.reports


@pytest.fixture
def thesis_step(tmp_path):
    """A long run past its first ticks, its log and its two nodes."""
    with running(tmp_path, "thesis-step") as run:
        yield run


@pytest.mark.parametrize(("victim", "left"), [("plant", "controller"), ("controller", "plant")])
def test_after_sigkill_the_other_ends_the_line_names_it_and_no_tick_is_lost(
    victim, left, thesis_step
):
    process, log, nodes = thesis_step
    before = lines_of(log) // 5
    os.kill(nodes[victim], signal.SIGKILL)
    wait_for(lambda: not alive(nodes[left]))
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 3
    line = one_line(errors)
    said = re.search(rf"the {victim} node was ended by SIGKILL after (\d+) ticks or more", line)
    assert said is not None
    assert f"the {left} node" not in line
    summary = folder_is_complete(log.parent, victim)
    assert summary["ticks"] == whole_ticks(log) >= max(before, int(said[1]))
    assert f"rate {summary['ticks_per_s']:.0f} ticks/s" in " ".join(output.split())
    assert lines_of(log.with_name("bus.plant.csv")) > summary["ticks"]  # the first line has names


@pytest.mark.parametrize(("pace", "waited"), [([], "1"), (["--pace", 2], "1.0005")])
def test_a_node_that_hangs_is_named_and_does_not_stay(tmp_path, pace, waited):
    victim = "controller"
    with running(tmp_path, "thesis-step", *pace) as (process, log, nodes):
        os.kill(nodes[victim], signal.SIGSTOP)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 3
        assert f"no frame from the {victim} node for {waited} s" in one_line(errors)
        assert not any(map(alive, nodes.values()))
        folder_is_complete(log.parent, victim)


def test_a_pace_slower_than_the_longest_silence_is_no_silence(tmp_path):
    done = rig("run", "thesis-step", "--pace", 0.0005, "--set", "duration_s=0.002",
               "--set", "fault.kind=none", "--out", tmp_path / "run")  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_a_killed_run_leaves_no_node_that_waits_for_an_operator(tmp_path):
    with running(tmp_path, "thesis-step", "--pace", 1) as run:
        run.process.kill()
        wait_for(lambda: not any(map(alive, run.nodes.values())))


def test_ctrl_c_ends_both_cleanly_and_leaves_a_complete_folder(thesis_step):
    """Thrice and to the whole group: what a terminal does, and an impatient person."""
    process, log, nodes = thesis_step
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
    assert f"stopped after {summary['ticks']} of " in output


def test_ctrl_c_while_the_nodes_start_is_as_quiet_and_leaves_no_empty_folder(tmp_path):
    process = start("run", "thesis-step", *LONG, "--out", tmp_path / "run")
    wait_for((tmp_path / "run").is_dir)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors + output
    assert "error" not in errors
    assert "stopped before the first tick; no run folder is left" in output
    assert not (tmp_path / "run").exists()


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


CONTROLLER = """
import ctypes, os, threading, time

class Controller:
    def __init__(self, setup):
        {made}

    def reset(self, reference):
        pass

    def step(self, inputs):
        {asked}
        return 0.0, 0.0
"""


def controller_in(folder: Path, made: str = "pass", asked: str = "pass") -> str:
    """The kind of a controller with these statements in ``__init__`` and in ``step``."""
    (folder / "ending.py").write_text(CONTROLLER.format(made=made, asked=asked))
    return f"{folder / 'ending'}:Controller"


@pytest.mark.parametrize(
    ("ends", "line"),
    [("os._exit(0)", "ended with exit status 0"), ("ctypes.string_at(0)", "was ended by SIGSEGV")],
)
def test_a_controller_that_ends_its_process_in_the_check_is_named(ends, line, tmp_path):
    kind = controller_in(tmp_path, asked=ends)
    process = start("run", "--set", f"controller.kind={kind}", "--out", tmp_path / "run")
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 3
    assert one_line(errors) == f"error: the check before the run, which calls {kind}, {line}"
    assert not (tmp_path / "run").exists()


def test_ctrl_c_ends_a_check_whose_controller_never_answers(tmp_path):
    controller_in(tmp_path, asked="open('begun', 'w'); time.sleep(600)")
    process = start("run", "--set", "controller.kind=ending:Controller", cwd=tmp_path)
    wait_for((tmp_path / "begun").exists)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (130, "")
    assert "stopped before the first tick" in output


def test_a_check_without_an_answer_ends():
    with pytest.raises(
        SilentNodeError,
        match=r"the check before the run, which calls a\.so, did not answer for 0\.3",
    ):
        in_another_process(lambda on_tick: time.sleep(600), "a.so", StopRequest(), 0.3)


def test_in_real_time_a_controller_that_ends_shortly_before_the_run_is_named(tmp_path):
    """The plant goes on to the end: less than the permitted silence is left."""
    comm = "open('/proc/self/comm').read().strip()"
    ends = f"if inputs.reference > 0.1 and {comm} == 'rig-controller': os._exit(0)"
    kind = controller_in(tmp_path, asked=ends)
    process = start(
        "run", "--realtime", "--set", f"controller.kind={kind}",
        "--set", "latency_ticks=1", "--set", "tick_s=0.005", "--set", "duration_s=1.5",
        "--set", "reference.kind=lane-change",
        "--allow-unstable", "--out", tmp_path / "run",
    )  # fmt: skip
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 3
    said = "controller node: ended with exit status 0"
    assert said in one_line(errors)
    assert "realtime" in summary_of(tmp_path / "run", said)


@pytest.mark.parametrize(
    ("how", "number", "status"),
    [
        (["--in-process"], signal.SIGINT, 130),
        (["--in-process"], signal.SIGTERM, -15),
        ([], signal.SIGINT, 130),
    ],
)
def test_a_thread_of_a_controller_does_not_outlive_a_signal_after_the_run(
    tmp_path, how, number, status
):
    made = "threading.Thread(target=time.sleep, args=(600,)).start()"
    kind = controller_in(tmp_path, made)
    process = start(
        "run", "thesis-step", "--set", "duration_s=0.1", "--set", "fault.kind=none",
        *how, "--allow-unstable", "--out", tmp_path / "run", "--set", f"controller.kind={kind}",
    )  # fmt: skip
    for line in process.stdout:
        if line.startswith("run folder"):
            break
    time.sleep(0.5)  # of the command nothing is left
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == status
    assert errors == ""
