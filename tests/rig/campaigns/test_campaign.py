"""A campaign from start to end: one table whoever computes it, and every row repeatable."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd
import psutil
import pytest
import tomli_w
from distributed import Future, KilledWorker, LocalCluster

from can_rig.campaigns import cluster
from can_rig.campaigns.cluster import on_cluster, rows_of
from can_rig.campaigns.execution import CampaignFolder, execute, open_folder
from can_rig.campaigns.plan import plan
from can_rig.campaigns.rows import METRICS, TRUTHS, Task, run_rows
from can_rig.campaigns.settings import campaign_of
from can_rig.campaigns.workers import DEATHS, deaths_after, serially, versions
from can_rig.errors import INTERRUPTED, RigError, RunFolderError, ScenarioError, WorkersLostError
from can_rig.results.metrics import Metrics, metrics_of
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from tests.helpers import asked, succeeded
from tests.processes import wait_for
from tests.rig.campaigns.running import SHORT, in_two_processes, planned, ran, rows

FAR_CLUSTER = """
import sys
from distributed import LocalCluster
with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
                  protocol="tcp") as far:
    print(far.scheduler_address, flush=True)
    sys.stdin.read()
"""
CLASS_THAT_FAILS = """
class Brittle:
    def __init__(self, settings):
        self.heavy = settings.mass_kg > 1400.0
        self.reset()
    def reset(self): self.n = 0
    def advance(self, dt_s, torque_nm, force_difference_n):
        self.n += 1
        if self.heavy and self.n > 50: raise RuntimeError("axle broken")
        return 1e-4 * torque_nm
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    return ran(tmp_path_factory.mktemp("campaign") / "one", planned())


def written(folder: Path, name: str = "some", **values: Any) -> Path:
    """``SHORT`` with other keys as a file."""
    (folder / f"{name}.toml").write_text(tomli_w.dumps({**SHORT, **values}))
    return folder / f"{name}.toml"


@pytest.fixture(scope="module")
def address():
    """Of a cluster in this process: a scheduler, and a worker with two threads."""
    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0", protocol="tcp"
    ) as local:
        yield local.scheduler_address


def test_the_metrics_are_those_of_every_run():
    values = metrics_of(load("default", ["duration_s=0.06", "fault.at_s=0.03"]))
    assert tuple(values) == METRICS
    assert {name for name, value in values.items() if isinstance(value, bool)} <= TRUTHS


def test_every_row_can_be_repeated_to_the_bit(done, tmp_path):
    for row in rows(done)[::11]:
        words = shlex.split(row["command"])
        assert words[:2] == ["can-rig", "run"]
        again = succeeded(*words[1:], "--json", "--out", tmp_path / str(row["run"]))
        told = json.loads(again.stdout)["metrics"]
        assert {name: row[name] for name in METRICS} == told
        scenario = json.loads((tmp_path / str(row["run"]) / "run.json").read_text())["scenario"]
        assert row["seed"] == scenario["seed"]
        assert row["plant.mass_kg"] == scenario["plant"]["mass_kg"]


def test_the_table_has_types_units_and_verdicts(done):
    found = rows(done)
    assert [row["run"] for row in found] == list(range(12))
    assert all(
        row["failure"] is None and row["simulated_s"] == pytest.approx(0.06) for row in found
    )
    for row in found:
        small = row["deviation_peak_after_fault_mps2"] <= 1e-3 or row["missed_detection"]
        assert row["passed.small"] == small
        assert (row["margin"] >= 0.0) == small
    assert not (done.path / "blocks").exists()
    table = pd.read_parquet(done.table)
    units = table.attrs["units"]
    assert units["deviation_peak_after_fault_mps2"] == "m/s²"
    assert (units["simulated_s"], units["torque_peak_nm"]) == ("s", "N m")
    assert (units["plant.mass_kg"], units["astray_m"]) == ("kg", "m")
    assert units["false_alarms_per_hour"] == "1/h"
    assert not {"run", "command", "passed.small"} & set(units)


def test_a_truth_that_a_run_lacks_is_unknown_to_pandas(tmp_path):
    """And not an object column, in which False and None are alike."""
    axes = {"fault.kind": {"values": ["none", "actuator-dead"]}}
    table = pd.read_parquet(ran(tmp_path / "mixed", planned(runs=8, axes=axes)).table)
    for name in ("missed_detection", "passed.small"):
        assert table[name].dtype == "boolean"
        assert (table[name].isna() == (table["fault.kind"] == "none")).all()
    assert 0 < table["missed_detection"].isna().sum() < 8


def test_the_file_does_not_depend_on_interruptions(done, tmp_path):
    again = ran(tmp_path / "again", planned(), serially, stops=1)
    assert again.table.read_bytes() == done.table.read_bytes()


@pytest.mark.parametrize("search", [None, "small"])
def test_a_cluster_makes_the_same_table(search, address, tmp_path):
    some = planned(search=search)
    here, there = (
        ran(tmp_path / name, some, who).table.read_bytes()
        for name, who in (("here", serially), ("there", lambda some: on_cluster(some, address)))
    )
    assert here == there


def fork_server_and_workers() -> list[psutil.Process]:
    """The fork server, then the workers that it started."""
    found = []
    for each in psutil.Process().children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # just killed
            found += [each] if "forkserver" in " ".join(each.cmdline()) else []
    return found


@pytest.mark.parametrize("which", ["worker", "fork server"])
def test_a_process_that_is_killed_costs_nothing(which, done, tmp_path):
    victims: list[int] = []

    def kill_one(count: int) -> None:
        processes = fork_server_and_workers()
        if not victims and len(processes) > 1:
            victim = processes[0 if which == "fork server" else 1]
            victims.append(victim.pid)
            victim.kill()

    folder = ran(tmp_path / "killed", planned(), in_two_processes, on_done=kill_one)
    assert victims
    assert folder.table.read_bytes() == done.table.read_bytes()


def test_ctrl_c_reaches_no_worker_and_no_fork_server_from_the_start_on(tmp_path):
    """Their imports, which take seconds, would print tracebacks."""
    deaf: list[bool] = []

    def look(_done: int) -> None:
        for each in fork_server_and_workers():
            blocked = re.search(r"SigBlk:\s*(\w+)", Path(f"/proc/{each.pid}/status").read_text())
            deaf.append(bool(blocked and int(blocked[1], 16) >> (signal.SIGINT - 1) & 1))

    ran(tmp_path / "deaf", planned(), in_two_processes, on_done=look)
    assert len(deaf) > 1
    assert all(deaf)
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


ENDLESS = """
from pathlib import Path

def endless(inputs):
    Path("begun").touch()
    while True:
        pass
"""


@pytest.mark.parametrize("workers", [1, 2])
def test_the_second_ctrl_c_waits_for_no_run(workers, tmp_path):
    (tmp_path / "own.py").write_text(ENDLESS)
    file = written(tmp_path, settings={**SHORT["settings"], "controller.kind": "own:endless"})
    started = subprocess.Popen(
        [sys.executable, "-m", "can_rig", "campaign", file, "--workers", str(workers),
         "--out", "out"], cwd=tmp_path,
    )  # fmt: skip
    try:
        wait_for((tmp_path / "begun").exists)
        some = psutil.Process(started.pid).children(recursive=True)
        started.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            started.wait(1.0)
        started.send_signal(signal.SIGINT)
        assert started.wait(60.0) == INTERRUPTED
        assert not psutil.wait_procs(some, 60.0)[1]
    finally:
        started.kill()


def test_workers_that_always_die_end_it_in_a_line(tmp_path, monkeypatch):
    (tmp_path / "deadly_car.py").write_text(
        "import os\nclass Deadly:\n    def __init__(self, settings):\n"
        f"        if os.getpid() != {os.getpid()}: os._exit(9)\n"
        "    def reset(self): pass\n"
        "    def advance(self, dt_s, torque_nm, force_difference_n): return 0.0\n"
    )
    monkeypatch.setattr("can_rig.campaigns.workers.DEATHS", 2)
    some = planned(settings={**SHORT["settings"], "plant.kind": "deadly_car:Deadly"})
    with pytest.raises(WorkersLostError, match=r"runs 0 to 0: the worker died 2 times"):
        ran(tmp_path / "out", some, in_two_processes)


def test_a_worker_of_a_cluster_that_dies_costs_nothing_and_one_that_always_dies_ends_it(
    address, monkeypatch
):
    deaths = iter([True, True, False, *[True] * 5])
    result = Future.result

    def dying(future: Any, timeout: float) -> Any:
        if next(deaths):
            raise KilledWorker("a task", None, 3)
        return result(future, timeout)

    monkeypatch.setattr(Future, "result", dying)
    with on_cluster(planned(), address) as compute:
        ((task, found),) = compute([Task(0, 1)])
        assert (task, found[0]["run"]) == (Task(0, 1), 0)
        with pytest.raises(WorkersLostError, match="runs 1 to 1: the worker died 5 times"):
            list(compute([Task(1, 2)]))


def test_a_cluster_that_all_workers_have_left_is_one_line(monkeypatch):
    monkeypatch.setattr(cluster, "ABSENCE_S", 0.5)
    with (
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
            protocol="tcp",
        ) as local,
        on_cluster(planned(), local.scheduler_address) as compute,
    ):  # fmt: skip
        found = compute([Task(0, 1), Task(1, 2), Task(2, 3)])
        assert next(found)[0] == Task(0, 1)
        local.scale(0)
        with pytest.raises(RigError, match=r"all workers have gone, .* 0\.5 s$"):
            while True:
                next(found)


def test_a_scheduler_that_is_killed_ends_it_in_a_line_and_here_it_goes_on(
    done, tmp_path, monkeypatch
):
    monkeypatch.setattr(cluster, "PATIENCE_S", 5.0)
    with subprocess.Popen(
        [sys.executable, "-c", FAR_CLUSTER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as far:
        assert far.stdout is not None
        address = far.stdout.readline().strip()

        def killing(folder: CampaignFolder, workers: Any, stopped: Any, _: Any) -> bool:
            return execute(folder, workers, stopped, lambda done: far.kill())

        monkeypatch.setattr("can_rig.cli.campaign.execute", killing)
        words = ("campaign", written(tmp_path), "--out", tmp_path / "out")
        ended = asked(*words, "--scheduler", address)
    assert ended.returncode == 3
    lines = [line for line in ended.stderr.splitlines() if "campaign folder" not in line]
    assert len(lines) == 1
    assert f"--scheduler {address}: went away; what is done is kept, and --resume" in lines[0]
    monkeypatch.undo()
    assert asked(*words, "--resume", "--workers", 1).returncode in {0, 1}
    assert (tmp_path / "out" / "runs.parquet").read_bytes() == done.table.read_bytes()


def test_workers_lost_before_the_first_run_leave_nothing_to_resume(tmp_path, monkeypatch):
    def losing(*_: Any) -> bool:
        return bool(deaths_after(DEATHS - 1, Task(0, 1)))

    monkeypatch.setattr("can_rig.cli.campaign.execute", losing)
    ended = asked("campaign", written(tmp_path), "--out", tmp_path / "out", "--workers", 1)
    assert ended.returncode == 3
    assert "the worker died" in ended.stderr
    assert "--resume" not in ended.stderr
    assert not (tmp_path / "out").exists()


def test_other_versions_are_refused_in_a_line():
    with pytest.raises(RigError, match=r"a worker has numpy .*, and not 0\.1 as here"):
        rows_of(b"", Task(0, 1), {**versions(), "numpy": "0.1"})


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--scheduler", "tcp://127.0.0.1:1"], "--scheduler tcp://127.0.0.1:1: cannot be reached"),
        (["--scheduler", "nonsense://x"], "--scheduler nonsense://x: cannot be reached"),
        (["--scheduler", "tcp://127.0.0.1:1", "--workers", "2"], "must come without --workers"),
    ],
)
def test_a_cluster_that_is_not_there_is_one_line(arguments, line, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.5)
    refused = asked("campaign", "losses", "--runs", 2, "--out", tmp_path / "out", *arguments)
    assert refused.returncode == 2
    assert line in re.sub(r"\s+", " ", refused.stderr)
    assert "Traceback" not in refused.stderr


def test_a_run_that_fails_is_a_row_with_its_reason(tmp_path, monkeypatch):
    (tmp_path / "brittle_car.py").write_text(CLASS_THAT_FAILS)
    axes = {"plant.mass_kg": {"values": [1300.0, 1500.0]}, "tick_s": {"values": [0.001, 1e-9]}}
    settings = {**SHORT["settings"], "plant.kind": "brittle_car:Brittle"}
    some = plan(campaign_of("some", {"sampling": "grid", "axes": axes, "settings": settings}))
    found = run_rows(some, Task(0, 4))
    assert "failure" not in found[0]
    assert "axle broken" in found[2]["failure"]
    assert ["simulated_s" in row for row in found] == [True, False, False, False]
    assert all("tick_s = 1e-09: must be" in found[at]["failure"] for at in (1, 3))

    def impossible(_: Scenario) -> Metrics:
        raise AssertionError("found after 0.0002 s")

    monkeypatch.setattr("can_rig.campaigns.rows.metrics_of", impossible)
    (row,) = run_rows(some, Task(0, 1))
    assert row["failure"] == "AssertionError: found after 0.0002 s"
    assert "--set plant.mass_kg=1300.0" in row["command"]


def test_what_may_not_be_replaced_or_gone_on_with_is_said(tmp_path):
    path = tmp_path / "there"
    with open_folder(path, planned(), resume=False, force=False).made as made:
        (made.making / "blocks" / "00000000.parquet").write_text("of an earlier run")
    new, resumed, forced = (
        {"resume": resume, "force": force}
        for resume, force in ((False, False), (True, False), (False, True))
    )
    for at, values, how, error, line in (
        (path, {}, new, RunFolderError, "there already"),
        (path, {"seed": 1}, resumed, RunFolderError, "campaign seed is 0 there and 1 now"),
        (path, {"settings": {}}, resumed, RunFolderError, "campaign settings is"),
        (tmp_path, {}, resumed, RunFolderError, "not the folder of a campaign; --resume"),
        (tmp_path, {}, forced, RunFolderError, "not the folder of a campaign, so --force"),
        (path, {"requirements": {"x": "y > 1"}}, forced, ScenarioError, "no such metric"),
    ):
        with pytest.raises(error, match=line):
            open_folder(at, planned(**values), **how)
    open_folder(path, planned(seed=1), **forced)


def test_a_changed_file_of_a_run_is_another_campaign(tmp_path):
    """Half of the rows would be of one class, half of another."""
    module, library, table = (tmp_path / name for name in ("law.py", "law.so", "r.csv"))
    values = {"axes": {"controller.kind": {"values": [f"{tmp_path}/law:Law", f"c:{library}"]}},
              "settings": {**SHORT["settings"], "reference": {"kind": "csv", "file": str(table)}},
              "description": "x" * 5000}  # fmt: skip
    module.write_text("class Law: pass")
    library.write_bytes(b"1")
    table.write_text("0,0\n1,1\n")
    path = tmp_path / "out"
    open_folder(path, planned(**values), resume=False, force=False).made.close()
    open_folder(path, planned(**values), resume=True, force=False).made.close()
    for file in (module, library, table):
        before = file.read_bytes()
        file.write_bytes(before + b"\n")
        with pytest.raises(RunFolderError, match=f"file {file} is '.*must be the same to go on"):
            open_folder(path, planned(**values), resume=True, force=False)
        file.write_bytes(before)


def test_a_campaign_that_is_killed_goes_on_where_it_was(tmp_path):
    values = {"runs": 24, "settings": {**SHORT["settings"], "duration_s": 1.0}}
    file, blocks = written(tmp_path, **values), tmp_path / "out" / "blocks"
    words = [sys.executable, "-m", "can_rig", "campaign", file, "--workers", "2"]
    for signum in (signal.SIGKILL, signal.SIGINT):
        more = ["--resume"] if blocks.exists() else []
        before = len(list(blocks.glob("*.parquet"))) if more else 0
        started = subprocess.Popen(
            [*words, "--out", "out", *more], cwd=tmp_path, stdout=subprocess.PIPE, text=True
        )
        deadline = time.monotonic() + 120.0
        while time.monotonic() < deadline and started.poll() is None:
            if len(list(blocks.glob("*.parquet"))) > before + 1:
                break
            time.sleep(0.05)
        started.send_signal(signum)
        said, _ = started.communicate(timeout=60)
        if signum == signal.SIGINT and started.returncode not in {0, 1}:
            assert started.returncode == 130
            assert "of 24 runs are done; --resume --out out goes on" in said
    ended = asked("campaign", file, "--out", tmp_path / "out", "--resume", "--workers", 1, "--json")
    assert ended.returncode in {0, 1}, ended.stderr
    assert json.loads(ended.stdout)["runs"] == 24
    whole = ran(tmp_path / "whole", planned(**values)).table
    assert (tmp_path / "out" / "runs.parquet").read_bytes() == whole.read_bytes()
