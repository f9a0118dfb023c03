"""Computing a campaign's runs: this process, several, or a cluster (``cluster``).

The task and the campaign alone determine the rows, so a task may be computed anywhere, at any time,
and repeatedly.
"""

import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from itertools import islice
from multiprocessing import get_context, parent_process, resource_tracker
from threading import Thread
from typing import Any, Final

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.rows import Row, Task, run_rows
from can_rig.errors import WorkersLostError


@cache
def versions() -> dict[str, str]:
    """Versions of this process, by package."""
    packages = ("fault-tolerant-steering", "numpy", "scipy", "numba")
    return {package: version(package) for package in packages}


Done = Iterator[tuple[Task, list[Row]]]
Compute = Callable[[Iterable[Task]], Done]
"""Takes tasks on demand, and yields the rows of each task in any order."""

DEATHS: Final = 5
"""Successive deaths of workers without progress that rule out chance."""

PAUSE_S: Final = 0.2
"""Wait after a death, times the number of successive deaths."""

AHEAD: Final = 2
"""Tasks given out at once, for each worker."""

_plan: Plan | None = None


@contextmanager
def serially(plan: Plan) -> Iterator[Compute]:
    """Compute in this process."""

    def compute(tasks: Iterable[Task]) -> Done:
        for task in tasks:
            yield task, run_rows(plan, task)

    yield compute


@contextmanager
def in_processes(plan: Plan, workers: int) -> Iterator[Compute]:
    """Compute in ``workers`` processes; a process that dies is replaced.

    Computing raises WorkersLostError if workers die again and again.
    """
    processes = _Processes(plan, workers)
    try:
        yield processes.compute
    finally:
        processes.end()


class _Processes:
    """A process pool, replaced after a breakdown."""

    def __init__(self, plan: Plan, workers: int) -> None:
        self._plan, self._workers = plan, workers
        self._context = get_context("forkserver")
        self._context.set_forkserver_preload(["can_rig.campaigns.rows"])
        resource_tracker.ensure_running()  # would let Ctrl-C in again
        self._pool: ProcessPoolExecutor | None = None

    def compute(self, tasks: Iterable[Task]) -> Done:
        """See ``Compute``."""
        todo, deaths = Todo(tasks), 0
        running: dict[Future[list[Row]], Task] = {}
        while todo or running:
            try:
                while len(running) < AHEAD * self._workers and todo:
                    running[self._submit(todo.first)] = todo.first
                    todo.take()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    rows = future.result()
                    deaths = 0
                    yield running.pop(future), rows
            except (BrokenProcessPool, EOFError, ConnectionError):  # worker or fork server died
                self.end()
                todo.put_back(running.values())
                deaths = deaths_after(deaths, todo.first)
                running = {}
                time.sleep(PAUSE_S * deaths)  # a killed fork server takes time to end

    def end(self) -> None:
        """Cancel the running tasks."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None

    def _submit(self, task: Task) -> Future[list[Row]]:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self._workers, self._context, _begin, (self._plan,))
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # also of who is started
        try:
            return self._pool.submit(_rows, task)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Todo:
    """Queue of tasks that no worker has taken, in the order of their runs."""

    def __init__(self, tasks: Iterable[Task]) -> None:
        self._tasks = iter(tasks)
        self._next: list[Task] = []

    def __bool__(self) -> bool:
        if not self._next:
            self._next += islice(self._tasks, 1)
        return bool(self._next)

    @property
    def first(self) -> Task:
        """The next task; the queue must not be empty."""
        return self._next[0]

    def take(self) -> Task:
        """Remove and return the next task."""
        return self._next.pop(0)

    def put_back(self, tasks: Iterable[Task]) -> None:
        """Return tasks to the queue that were not completed."""
        self._next = sorted([*self._next, *tasks])


def deaths_after(before: int, first: Task) -> int:
    """Count one more death of a worker.

    Raises:
        WorkersLostError: the count reaches ``DEATHS``.
    """
    if before + 1 == DEATHS:
        raise WorkersLostError(
            f"runs {first.begin} to {first.end - 1}: the worker died {DEATHS} times; "
            "is there enough memory?"
        )
    return before + 1


def _begin(plan: Plan) -> None:
    """Initialise a new worker, which ends with its parent."""
    global _plan  # noqa: PLW0603 (set once per process)
    _plan = plan
    Thread(target=_end_with, args=(parent_process(),), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _rows(task: Task) -> list[Row]:
    assert _plan is not None
    return run_rows(_plan, task)
