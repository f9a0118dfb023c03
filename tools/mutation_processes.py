"""Processes that each try one mutant, a few at a time."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from multiprocessing import connection, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

TREE: Final = Path(__file__).parents[1] / "build" / "mutation"
"""A copy of the checkout, so that work on that can go on meanwhile."""

_LONGEST_S: Final = 7200.0  # for all tests


Work = Callable[[Any], Any]
"""What a process does with a job, and what it answers."""


def answers(work: Work, jobs: Mapping[str, Any], workers: int) -> Iterator[tuple[str, Any]]:
    """Each key of ``jobs`` with what ``work`` has sent for it; None where it has sent nothing."""
    fork = get_context("fork")
    waiting = list(jobs)[::-1]
    running: dict[Any, tuple[str, Path, Connection, float]] = {}
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as root:
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    key = waiting.pop()
                    folder = Path(tempfile.mkdtemp(dir=root))
                    receiver, sender = fork.Pipe(duplex=False)
                    process = fork.Process(target=_run, args=(work, jobs[key], folder, sender))
                    process.start()
                    sender.close()
                    running[process] = key, folder, receiver, time.monotonic() + _LONGEST_S
                connection.wait([receiver for _, _, receiver, _ in running.values()], timeout=1.0)
                for process, (key, folder, receiver, deadline_s) in list(running.items()):
                    answer = None
                    if receiver.poll():
                        with suppress(EOFError):
                            answer = receiver.recv()
                    elif time.monotonic() < deadline_s:
                        continue
                    _end(process)
                    shutil.rmtree(folder, ignore_errors=True)
                    del running[process]
                    yield key, answer
        finally:
            for process in running:
                _end(process)


def _end(process: Any) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)  # with all that it started
    process.join()


def _run(work: Work, job: Any, folder: Path, to: Connection) -> None:
    """In a process of its own, silently; ``folder`` is for temporary files."""
    os.setpgrp()  # in the session of its parent, and so at the priority that this was given
    silence = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silence, stream)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)  # ends the process
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.environ["PYTEST_DEBUG_TEMPROOT"] = str(folder)
    to.send(work(job))
    os._exit(0)  # whatever threads a mutant has left behind
