"""Who computes the blocks of a campaign: this process, or several.

A block is decided by its number alone, so it does not matter who computes it, when, or how often.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import Any, Final

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.run import Row, run_rows
from can_rig.errors import RigError

Range = tuple[int, int]
"""Of a block: its first run, and the first behind it."""

Done = Iterator[tuple[Range, list[Row]]]

DEATHS: Final = 3
"""Times in a row that workers may die before anything is done; then it is not by chance."""

AHEAD: Final = 2
"""Blocks for each worker that are given out at once."""

_plan: Plan | None = None


def serially(plan: Plan, blocks: list[Range], stopped: Callable[[], bool]) -> Done:
    """The rows of every block, computed here, until ``stopped``."""
    for begin, end in blocks:
        if stopped():
            return
        yield (begin, end), run_rows(plan, begin, end)


def in_processes(
    plan: Plan, blocks: list[Range], workers: int, stopped: Callable[[], bool]
) -> Done:
    """The same by ``workers`` processes, in whatever order; a worker that dies is replaced.

    Raises:
        RigError: workers die again and again.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload(["can_rig.campaigns.run"])
    open_blocks, deaths = list(reversed(blocks)), 0
    while open_blocks and not stopped():
        pool = ProcessPoolExecutor(workers, context, _begin, (plan,))
        running: dict[Future[list[Row]], Range] = {}
        try:
            while (open_blocks and not stopped()) or running:
                while open_blocks and not stopped() and len(running) < AHEAD * workers:
                    block = open_blocks.pop()
                    running[pool.submit(_block, block)] = block
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    rows = future.result()
                    deaths = 0
                    yield running.pop(future), rows
        except BrokenProcessPool:
            open_blocks += sorted(running.values(), reverse=True)
            deaths += 1
            if deaths == DEATHS:
                begin, end = min(running.values())
                raise RigError(
                    f"runs {begin} to {end - 1}: the worker died {DEATHS} times; "
                    "is there enough memory? what is done is kept, and --resume goes on"
                ) from None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _begin(plan: Plan) -> None:
    """In a new worker: Ctrl-C is its parent's affair, and it does not outlive that."""
    global _plan  # noqa: PLW0603 (one a process)
    _plan = plan
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with, args=(parent_process(),), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _block(block: Range) -> list[Row]:
    assert _plan is not None
    return run_rows(_plan, *block)
