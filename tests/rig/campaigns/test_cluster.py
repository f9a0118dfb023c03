"""A campaign on a Dask cluster: the same table, and one line where the cluster is not there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import Future, KilledWorker, LocalCluster

from can_rig.campaigns import cluster
from can_rig.campaigns.cluster import on_cluster, rows_of
from can_rig.campaigns.execution import execute, open_folder
from can_rig.campaigns.plan import Plan, plan
from can_rig.campaigns.rows import Task
from can_rig.campaigns.settings import campaign_of
from can_rig.campaigns.workers import serially, versions
from can_rig.errors import RigError
from tests.helpers import asked

VALUES: dict[str, Any] = {
    "settings": {"duration_s": 0.06, "fault.at_s": 0.03, "fault.kind": "actuator-dead"},
    "axes": {"fault.left": {"range": [0.0, 0.9]}},
    "requirements": {"small": "deviation_peak_after_fault_mps2 <= 1e-3"},
    "runs": 6,
}


def planned(**values: Any) -> Plan:
    return plan(campaign_of("some", {**VALUES, **values}))


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Of a cluster in this process: a scheduler, and a worker with two threads."""
    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0", protocol="tcp"
    ) as local:
        yield local.scheduler_address


@pytest.mark.parametrize("search", [None, "small"])
def test_a_cluster_makes_the_same_table(search: str | None, address: str, tmp_path: Path) -> None:
    tables = []
    some = planned(search=search)
    for name, workers in (
        ("here", serially(some)),
        ("there", on_cluster(some, address)),
    ):
        folder = open_folder(tmp_path / name, some, resume=False, force=False)
        assert execute(folder, workers, lambda: False, str)
        tables.append(folder.table.read_bytes())
    assert tables[0] == tables[1]


def test_a_worker_that_dies_costs_nothing_and_one_that_always_dies_ends_it(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    deaths = iter([True, True, False, *[True] * 5])
    result = Future.result

    def dying(future: Any, timeout: float) -> Any:
        if next(deaths):
            raise KilledWorker("a task", None, 3)
        return result(future, timeout)

    monkeypatch.setattr(Future, "result", dying)
    with on_cluster(planned(), address) as compute:
        ((task, rows),) = compute([Task(0, 1)])
        assert (task, rows[0]["run"]) == (Task(0, 1), 0)
        with pytest.raises(RigError, match="runs 1 to 1: the worker died 5 times"):
            list(compute([Task(1, 2)]))


def test_a_cluster_that_all_workers_have_left_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cluster, "ABSENCE_S", 0.5)
    with (
        LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            dashboard_address=None,
            protocol="tcp",
        ) as local,
        on_cluster(planned(), local.scheduler_address) as compute,
    ):
        rows = compute([Task(0, 1), Task(1, 2), Task(2, 3)])
        assert next(rows)[0] == Task(0, 1)
        local.scale(0)
        with pytest.raises(RigError, match=r"all workers have gone, .* 0\.5 s; .* --resume"):
            while True:
                next(rows)


def test_other_versions_are_refused_in_a_line() -> None:
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
def test_a_cluster_that_is_not_there_is_one_line(
    arguments: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.5)
    done = asked("campaign", "losses", "--runs", 2, "--out", tmp_path / "out", *arguments)
    assert done.returncode == 2
    assert line in re.sub(r"\s+", " ", done.stderr)
    assert "Traceback" not in done.stderr
