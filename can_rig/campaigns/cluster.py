"""Computing a campaign on a Dask cluster; workers need only this package.

A worker receives a task and its campaign, and returns rows: the files are written here. So no run
is lost or counted twice if a worker dies, is slow, or repeats a task. A lost scheduler ends the
command; finished blocks are kept.
"""

import asyncio
import pickle
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import lru_cache
from threading import Lock
from typing import Any, Final

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.rows import Row, Task, run_rows
from can_rig.campaigns.workers import AHEAD, Compute, Done, Todo, deaths_after, versions
from can_rig.errors import RigError, WorkersLostError, one_line, require

PATIENCE_S: Final = 30.0
"""For the scheduler to answer, and for its first worker."""

ABSENCE_S: Final = 120.0
"""For workers to come back when all have gone."""

_ONE_AT_A_TIME: Final = Lock()
"""Threads of a worker share the cache of a scenario, and one core's worth of Python."""


@contextmanager
def on_cluster(plan: Plan, scheduler: str) -> Iterator[Compute]:
    """The cluster of the scheduler at that address.

    Raises:
        MissingExtraError: distributed is not installed.
        RigError: no scheduler answers, or no worker is connected; computing raises RigError if the
            scheduler goes away, workers die again and again, or packages differ in version.
    """
    require("distributed", extra="cluster")
    from distributed import Client  # noqa: PLC0415 (an extra)

    try:
        client = Client(scheduler, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise RigError(f"--scheduler {scheduler}: cannot be reached: {one_line(error)}") from None
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
        yield _Cluster(client, scheduler, plan).compute
    except TimeoutError:
        raise RigError(f"--scheduler {scheduler}: has no workers") from None
    finally:
        with suppress(OSError, CancelledError):  # the scheduler may have gone
            client.close(timeout=PATIENCE_S)


class _Cluster:
    def __init__(self, client: Any, scheduler: str, plan: Plan) -> None:
        self._client, self._scheduler = client, scheduler
        self._plan = pickle.dumps(plan)
        self._asked = 0

    def compute(self, tasks: Iterable[Task]) -> Done:
        """See ``Compute``.

        Raises:
            WorkersLostError: the scheduler goes away, at whatever moment.
        """
        try:
            yield from self._computed(tasks)
        except (OSError, CancelledError, asyncio.CancelledError):
            raise WorkersLostError(f"--scheduler {self._scheduler}: went away") from None

    def _computed(self, tasks: Iterable[Task]) -> Done:
        from distributed import KilledWorker, wait  # noqa: PLC0415 (an extra)

        todo, deaths = Todo(tasks), 0
        running: dict[Any, Task] = {}
        while todo or running:
            while len(running) < AHEAD * max(1, self._threads) and todo:
                task = todo.take()
                running[self._submit(task)] = task
            try:
                with self._client.as_current():
                    found = wait([*running], timeout=ABSENCE_S, return_when="FIRST_COMPLETED")
                future = next(iter(found.done))
                rows: list[Row] = future.result(ABSENCE_S)  # raises an exception of the task
            except TimeoutError:
                if not self._threads:
                    raise WorkersLostError(
                        f"--scheduler {self._scheduler}: all workers have gone, and none has come "
                        f"back within {ABSENCE_S:g} s"
                    ) from None
            except KilledWorker:
                task = running.pop(future)
                deaths = deaths_after(deaths, task)
                todo.put_back([task])
            else:
                deaths = 0
                yield running.pop(future), rows

    @property
    def _threads(self) -> int:
        """Of all workers now, which come and go."""
        return sum(self._client.nthreads().values())

    def _submit(self, task: Task) -> Any:
        self._asked += 1
        return self._client.submit(
            rows_of, self._plan, task, versions(), pure=False,
            key=f"runs {task.begin} to {task.end - 1}, {self._client.id}, {self._asked}",
        )  # fmt: skip


def rows_of(plan: bytes, task: Task, wanted: dict[str, str]) -> list[Row]:
    """On a worker: the rows of a task.

    Raises:
        RigError: the worker's packages differ in version from the client's.
    """
    found = versions()
    for package, version in wanted.items():
        if found[package] != version:
            raise RigError(
                f"a worker has {package} {found[package]}, and not {version} as here; "
                "must be the same"
            )
    with _ONE_AT_A_TIME:
        return run_rows(_plan_of(plan), task)


@lru_cache(1)
def _plan_of(written: bytes) -> Plan:
    plan: Plan = pickle.loads(written)
    return plan
