"""A campaign from start to end: one table whoever computes it, and every row repeatable."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import psutil
import pytest
from pyarrow import parquet

from can_rig.assessment.resolve import load
from can_rig.campaigns.execution import CampaignFolder, execute, open_folder
from can_rig.campaigns.plan import Plan, plan
from can_rig.campaigns.rows import METRICS, TRUTHS, Task, run_rows
from can_rig.campaigns.settings import campaign_of
from can_rig.campaigns.workers import Compute, in_processes, serially
from can_rig.errors import RunFolderError, ScenarioError
from can_rig.results.metrics import Metrics, metrics_of
from can_rig.scenario.settings import Scenario
from tests.helpers import asked

WhoComputes = AbstractContextManager[Compute]

SHORT: dict[str, Any] = {
    "settings": {"duration_s": 0.3, "fault.at_s": 0.2, "fault.kind": "actuator-dead"},
    "axes": {
        "plant.mass_kg": {"share": 0.2},
        "fault.left": {"range": [0.0, 0.9]},
        "design.compensation": {"values": ["always", "on-confirmation"]},
    },
    "requirements": {"small": "deviation_peak_after_fault_mps2 <= 0.05 or missed_detection"},
    "runs": 12,
}
TOML = """
scenario = "default"
runs = {runs}
[settings]
duration_s = {duration_s}
fault.at_s = 0.2
[axes]
"plant.mass_kg" = {{ share = 0.2 }}
[requirements]
small = "deviation_peak_after_fault_mps2 <= 1e3"
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


def planned(**values: Any) -> Plan:
    return plan(campaign_of("some", {**SHORT, **values}))


def by(some: Plan, number: int) -> WhoComputes:
    """This process, or so many others."""
    return serially(some) if number == 1 else in_processes(some, number)


def never() -> bool:
    """Nobody stops it."""
    return False


def quiet(_done: int) -> None:
    """Progress that nobody watches."""


def ran(path: Path, some: Plan, number: int = 1, blocks: int | None = None) -> CampaignFolder:
    """The campaign, stopped after so many blocks and gone on with."""
    folder = open_folder(path, some, resume=False, force=False)
    if blocks is not None:
        left = iter([False] * blocks)
        assert not execute(folder, by(some, number), lambda: next(left, True), quiet)
        assert 0 < folder.done < some.runs
        folder.made.close()  # as the end of a process does
        folder = open_folder(path, some, resume=True, force=False)
    assert execute(folder, by(some, number), never, quiet)
    return folder


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> CampaignFolder:
    return ran(tmp_path_factory.mktemp("campaign") / "one", planned())


def rows(folder: CampaignFolder) -> list[dict[str, Any]]:
    table: list[dict[str, Any]] = parquet.read_table(folder.table).to_pylist()
    return table


def test_the_metrics_are_those_of_every_run() -> None:
    values = metrics_of(load("default", ["duration_s=0.3", "fault.at_s=0.2"]))
    assert tuple(values) == METRICS
    assert {name for name, value in values.items() if isinstance(value, bool)} <= TRUTHS


def test_every_row_can_be_repeated_to_the_bit(done: CampaignFolder, tmp_path: Path) -> None:
    for row in rows(done)[::4]:
        words = shlex.split(row["command"])
        assert words[:2] == ["can-rig", "run"]
        again = asked(*words[1:], "--json", "--out", tmp_path / str(row["run"]))
        assert again.returncode == 0, again.stderr
        told = json.loads(again.stdout)["metrics"]
        assert {name: row[name] for name in METRICS} == told
        scenario = json.loads((tmp_path / str(row["run"]) / "run.json").read_text())["scenario"]
        assert row["seed"] == scenario["seed"]
        assert row["plant.mass_kg"] == scenario["plant"]["mass_kg"]


def test_the_table_has_types_and_verdicts(done: CampaignFolder) -> None:
    found = rows(done)
    assert [row["run"] for row in found] == list(range(12))
    assert all(row["failure"] is None and row["simulated_s"] == pytest.approx(0.3) for row in found)
    for row in found:
        small = row["deviation_peak_after_fault_mps2"] <= 0.05 or row["missed_detection"]
        assert row["passed.small"] == small
        assert (row["margin"] >= 0.0) == small
    assert not (done.path / "blocks").exists()


@pytest.mark.parametrize("number", [1, 2])
def test_the_file_does_not_depend_on_workers_or_interruptions(
    number: int, done: CampaignFolder, tmp_path: Path
) -> None:
    again = ran(tmp_path / "again", planned(), number, blocks=5)
    assert again.table.read_bytes() == done.table.read_bytes()


def test_a_worker_that_is_killed_costs_nothing(done: CampaignFolder, tmp_path: Path) -> None:
    folder = open_folder(tmp_path / "killed", planned(), resume=False, force=False)
    victims = []

    def kill_one(count: int) -> None:
        if len(victims) < 2 and count > 4 * len(victims):
            here = psutil.Process().children(recursive=True)
            busy = [each for each in here if "forkserver" in " ".join(each.cmdline())][1:]
            if busy:
                victims.append(busy[0].pid)
                busy[0].kill()

    assert execute(folder, by(planned(), 2), never, kill_one)
    assert victims
    assert folder.table.read_bytes() == done.table.read_bytes()


def test_workers_that_always_die_end_it_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deadly_car.py").write_text(
        "import os\nclass Deadly:\n    def __init__(self, settings):\n"
        f"        if os.getpid() != {os.getpid()}: os._exit(9)\n"
        "    def reset(self): pass\n"
        "    def advance(self, dt_s, torque_nm, force_difference_n): return 0.0\n"
    )
    some = planned(settings={**SHORT["settings"], "plant.kind": "deadly_car:Deadly"})
    folder = open_folder(tmp_path / "out", some, resume=False, force=False)
    with pytest.raises(Exception, match=r"runs 0 to 0: the worker died 5 times"):
        execute(folder, by(some, 2), never, quiet)


def test_a_run_that_fails_is_a_row_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "brittle_car.py").write_text(CLASS_THAT_FAILS)
    axes = {"plant.mass_kg": {"values": [1300.0, 1500.0]}, "tick_s": {"values": [0.001, 1e-9]}}
    settings = {**SHORT["settings"], "plant.kind": "brittle_car:Brittle"}
    some = plan(campaign_of("some", {"sampling": "grid", "axes": axes, "settings": settings}))
    found = run_rows(some, Task(0, 4))
    assert "failure" not in found[0]
    assert "axle broken" in found[2]["failure"]
    assert all("tick_s = 1e-09: must be" in found[at]["failure"] for at in (1, 3))

    def impossible(_: Scenario) -> Metrics:
        raise AssertionError("found after 0.0002 s")

    monkeypatch.setattr("can_rig.campaigns.rows.metrics_of", impossible)
    (row,) = run_rows(some, Task(0, 1))
    assert row["failure"] == "AssertionError: found after 0.0002 s"
    assert "--set plant.mass_kg=1300.0" in row["command"]


def test_what_may_not_be_replaced_or_gone_on_with_is_said(tmp_path: Path) -> None:
    path = tmp_path / "there"
    with open_folder(path, planned(), resume=False, force=False).made as made:
        (made.making / "blocks" / "00000000.parquet").write_text("of an earlier run")
    for values, keywords, line in (
        ({}, {"resume": False, "force": False}, "there already"),
        ({"seed": 1}, {"resume": True, "force": False}, "campaign seed is 0 there and 1 now"),
        ({"settings": {}}, {"resume": True, "force": False}, "campaign settings is"),
    ):
        with pytest.raises(RunFolderError, match=line):
            open_folder(path, planned(**values), **keywords)
    with pytest.raises(RunFolderError, match="not the folder of a campaign; --resume"):
        open_folder(tmp_path, planned(), resume=True, force=False)
    with pytest.raises(RunFolderError, match="not the folder of a campaign, so --force"):
        open_folder(tmp_path, planned(), resume=False, force=True)
    with pytest.raises(ScenarioError, match="no such metric"):
        open_folder(path, planned(requirements={"x": "y > 1"}), resume=False, force=True)
    open_folder(path, planned(seed=1), resume=False, force=True)


def test_a_campaign_that_is_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    (tmp_path / "many.toml").write_text(TOML.format(runs=24, duration_s=1.0))
    words = [sys.executable, "-m", "can_rig", "campaign", "many.toml", "--workers", "2"]
    for signum in (signal.SIGKILL, signal.SIGINT):
        more = ["--resume"] if (tmp_path / "out").exists() else []
        started = subprocess.Popen(
            [*words, "--out", "out", *more], cwd=tmp_path, stdout=subprocess.PIPE, text=True
        )
        before = len(list((tmp_path / "out" / "blocks").glob("*.parquet"))) if more else 0
        deadline = time.monotonic() + 120.0
        while time.monotonic() < deadline and started.poll() is None:
            if len(list((tmp_path / "out" / "blocks").glob("*.parquet"))) > before + 1:
                break
            time.sleep(0.05)
        started.send_signal(signum)
        said, _ = started.communicate(timeout=60)
        if signum == signal.SIGINT and started.returncode != 0:
            assert started.returncode == 130
            assert "of 24 runs are done; --resume --out out goes on" in said
    ended = subprocess.run(
        [*words, "--out", "out", "--resume", "--json"], cwd=tmp_path, capture_output=True,
        text=True, timeout=200, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["runs"] == 24
    whole = asked("campaign", tmp_path / "many.toml", "--workers", 1, "--out", tmp_path / "whole")
    assert whole.returncode == 0, whole.stderr
    killed, at_once = ((tmp_path / name / "runs.parquet").read_bytes() for name in ("out", "whole"))
    assert killed == at_once
