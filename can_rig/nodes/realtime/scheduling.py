"""What an operating system can do for a real-time node, as far as it permits."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

PRIORITY: Final = 50  # of SCHED_FIFO, 1 to 99: above everything ordinary, as the kernel's own IRQs
SWITCH_INTERVAL_S: Final = 2e-5  # Python's own 5 ms would let a progress bar hold up five ticks
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_MCL_ONFAULT = 4  # what is in use: all that is mapped would be three times as much
_SLACK = Path("/proc/self/timerslack_ns")


def prefer(core: int) -> str:
    """Ask for all that keeps this thread, and those that it starts, on time; what was granted.

    SCHED_FIFO and with it core number ``core`` of those permitted (counted from the last), memory
    that is never paged out, timers without slack. One line, which says why not where it was not.
    """
    return "; ".join((*_first_on_its_core(core), _locked(), *_no_slack()))


def _first_on_its_core(core: int) -> Iterator[str]:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        # Bound to a core all the same, it would wait for whoever is there instead of moving away.
        yield "no SCHED_FIFO and no core of its own (ulimit -r, or CAP_SYS_NICE, permits them)"
        return
    yield f"SCHED_FIFO {PRIORITY}"
    yield _own_core(core)


def _locked() -> str:
    # MCL_FUTURE only without a limit: with one, a later allocation would fail instead of waiting.
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
    """No garbage collector in the loop, and no other thread that keeps the interpreter for long.

    A tick makes no reference cycles, so nothing is left to the collector.
    """
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        sys.setswitchinterval(interval_s)
        gc.enable()
        gc.unfreeze()
