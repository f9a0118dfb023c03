"""One processor core for alternating lockstep nodes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_core() -> Iterator[None]:
    """Make processes forked inside share one core, with switches only on waits.

    Nodes in lockstep alternate, and waking another core costs more than the tick. Under SCHED_BATCH
    a frame does not preempt its sender, so a tick needs two switches instead of up to five.
    Parallel runs get different cores while cores last.
    """
    if not hasattr(os, "sched_setaffinity"):  # Linux alone has it
        yield
        return
    cores, policy, priority = (
        os.sched_getaffinity(0),
        os.sched_getscheduler(0),
        os.sched_getparam(0),
    )
    os.sched_setaffinity(0, {sorted(cores)[os.getpid() % len(cores)]})
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)
        os.sched_setaffinity(0, cores)
