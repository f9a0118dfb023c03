"""Who computes the runs of a campaign: this process, several, or a cluster (``cluster``).

A task is decided by what it says and by the campaign, so it does not matter who computes it, when,
or how often.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import Any, Final

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.run import Row, Task, run_rows
from can_rig.errors import WorkersLostError

Done = Iterator[tuple[Task, list[Row]]]
Compute = Callable[[Iterable[Task]], Done]
"""Tasks, taken as they are wanted, and the rows of each, in whatever order."""

DEATHS: Final = 5
"""Times in a row that workers may die before anything is done; then it is not by chance."""

AHEAD: Final = 2
"""Tasks for each worker that are given out at once."""

_plan: Plan | None = None


@contextmanager
def serially(plan: Plan) -> Iterator[Compute]:
    """No other than this process."""

    def compute(tasks: Iterable[Task]) -> Done:
        for task in tasks:
            yield task, run_rows(plan, task)

    yield compute


@contextmanager
def in_processes(plan: Plan, workers: int) -> Iterator[Compute]:
    """So many processes; one that dies is replaced.

    To compute raises WorkersLostError where workers die again and again.
    """
    processes = _Processes(plan, workers)
    try:
        yield processes.compute
    finally:
        processes.end()


class _Processes:
    """A pool, and another where that has broken."""

    def __init__(self, plan: Plan, workers: int) -> None:
        self._plan, self._workers = plan, workers
        self._context = get_context("forkserver")
        self._context.set_forkserver_preload(["can_rig.campaigns.run"])
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
            except (BrokenProcessPool, EOFError, ConnectionError):  # a worker, or who forks them
                self.end()
                todo.put_back(running.values())
                deaths = deaths_after(deaths, todo.first)
                running = {}

    def end(self) -> None:
        """What is under way is given up."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None

    def _submit(self, task: Task) -> Future[list[Row]]:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self._workers, self._context, _begin, (self._plan,))
        return self._pool.submit(_rows, task)


class Todo:
    """Tasks that nobody computes yet, in the order in which they are wanted."""

    def __init__(self, tasks: Iterable[Task]) -> None:
        self._tasks = iter(tasks)
        self._next: list[Task] = []

    def __bool__(self) -> bool:
        if not self._next:
            self._next += islice(self._tasks, 1)
        return bool(self._next)

    @property
    def first(self) -> Task:
        """The one that is wanted first; only where there is one."""
        return self._next[0]

    def take(self) -> Task:
        """The same, which somebody computes from now on."""
        return self._next.pop(0)

    def put_back(self, tasks: Iterable[Task]) -> None:
        """Tasks that were not computed in the end."""
        self._next = sorted([*self._next, *tasks])


def deaths_after(before: int, first: Task) -> int:
    """One more death of a worker.

    Raises:
        WorkersLostError: it is one too many.
    """
    if before + 1 == DEATHS:
        raise WorkersLostError(
            f"runs {first.begin} to {first.end - 1}: the worker died {DEATHS} times; "
            "is there enough memory? what is done is kept, and --resume goes on"
        )
    return before + 1


def _begin(plan: Plan) -> None:
    """In a new worker: Ctrl-C is its parent's affair, and it does not outlive that."""
    global _plan  # noqa: PLW0603 (one a process)
    _plan = plan
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with, args=(parent_process(),), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _rows(task: Task) -> list[Row]:
    assert _plan is not None
    return run_rows(_plan, task)
