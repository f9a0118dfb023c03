"""Services of the operating system: one core for nodes in lockstep, real-time scheduling."""

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final


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


PRIORITY: Final = 50  # of SCHED_FIFO, 1 to 99: above everything ordinary, as the kernel's own IRQs
SWITCH_INTERVAL_S: Final = 2e-5  # Python's own 5 ms would let a progress bar hold up five ticks
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_MCL_ONFAULT = 4  # in use: locking all mapped memory would take three times as much
_SLACK = Path("/proc/self/timerslack_ns")


@contextmanager
def preferred(core: int) -> Iterator[str]:
    """Real-time scheduling of this thread and its future threads; one line with the result.

    SCHED_FIFO with core number ``core`` of the permitted cores (counted from the last), memory
    that is never paged out, timers without slack; the line has reasons for refusals. Whatever takes
    long comes before and after the priority, because another node on the core waits meanwhile: a
    search for garbage, locked memory, the end of the process.
    """
    gc.collect()
    locked = _locked()
    try:
        yield "; ".join((*_first_on_its_core(core), locked, *_no_slack()))
    finally:
        with suppress(AttributeError, OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _first_on_its_core(core: int) -> Iterator[str]:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        # Without SCHED_FIFO, a thread bound to a core would wait for others instead of moving away.
        yield "no SCHED_FIFO and no core of its own (ulimit -r, or CAP_SYS_NICE, permits them)"
        return
    yield f"SCHED_FIFO {PRIORITY}"
    yield _own_core(core)


def _locked() -> str:
    # MCL_FUTURE only without a limit: otherwise a later allocation would fail instead of waiting.
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    try:
        failed = ctypes.CDLL(None).mlockall(
            _MCL_CURRENT | _MCL_ONFAULT | (_MCL_FUTURE if unlimited else 0)
        )
    except (AttributeError, OSError):
        failed = -1
    return "memory not locked (ulimit -l)" if failed else "memory locked"


def _own_core(core: int) -> str:
    try:
        cores = sorted(os.sched_getaffinity(0))
        if core >= len(cores):
            return f"shares core {cores[0]}"
        os.sched_setaffinity(0, {cores[-1 - core]})
    except OSError:
        return "no core of its own"
    return f"core {cores[-1 - core]}"


def _no_slack() -> Iterator[str]:
    try:
        _SLACK.write_text("1", encoding="ascii")  # 50 µs otherwise, without SCHED_FIFO
    except OSError:
        yield "timer slack as it is"


@contextmanager
def undisturbed() -> Iterator[None]:
    """Switch off garbage collection in the loop, and shorten other threads' turns.

    A tick makes no reference cycles, so the collector has no work.
    """
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        sys.setswitchinterval(interval_s)
        gc.enable()
        gc.unfreeze()
