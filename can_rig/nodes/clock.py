"""The rig's source of time, and progress reports of a run at a limited rate.

The clock is an argument everywhere, so tests control the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Final, Protocol

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """What time it is, and waiting."""

    def now_ns(self) -> int:
        """Nanoseconds since some moment; never goes back."""

    def sleep_until(self, at_ns: int) -> None:
        """Return at ``at_ns`` or later."""

    def stamp_s(self) -> float:
        """Time in seconds on the clock of the buses' time stamps; the date may jump at any time."""


class SystemClock:
    """CLOCK_MONOTONIC, which no setting of the date moves, and the date for time stamps."""

    def now_ns(self) -> int:
        """Nanoseconds since the machine started."""
        return time.monotonic_ns()

    def sleep_until(self, at_ns: int) -> None:
        """Sleep until ``at_ns``; a signal handler does not shorten the sleep."""
        left_ns = at_ns - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / NS_PER_S)

    def stamp_s(self) -> float:
        """Seconds since 1970."""
        return time.time()


SYSTEM_CLOCK = SystemClock()


PROGRESS_EVERY_S: Final = 0.1

OnTick = Callable[[int], None]
"""Called with the number of ticks completed."""

Progress = Callable[[], AbstractContextManager[OnTick]]
"""Entered once the nodes have started: a display may start a thread, and a process that is forked
has a copy of the thread's locks but not the thread."""


@contextmanager
def no_progress() -> Iterator[OnTick]:
    """Shows nothing."""
    yield lambda tick: None


class Throttled:
    """Calls ``report(tick)`` at most every 0.1 s; called each tick, it rarely reads the clock."""

    def __init__(self, report: OnTick, clock: Clock = SYSTEM_CLOCK) -> None:
        self._report = report
        self._clock = clock
        self._countdown = self._stride = 64
        self._last_ns = clock.now_ns()

    def __call__(self, tick: int) -> None:
        """Note that ``tick`` ticks are done."""
        self._countdown -= 1
        if self._countdown:
            return
        self._countdown = self._stride
        now_ns = self._clock.now_ns()
        if now_ns - self._last_ns >= PROGRESS_EVERY_S * NS_PER_S:
            self._last_ns = now_ns
            self._report(tick)


class Pace:
    """Ticks a second from the first tick on; a node may wait long for tick 1 or join late."""

    def __init__(self, clock: Clock, on_tick: OnTick) -> None:
        self._clock = clock
        self._on_tick = on_tick
        self._first: tuple[int, int] | None = None
        self._last_tick = 0

    def __call__(self, tick: int) -> None:
        """Record the arrival at ``tick``, and pass ``tick`` on."""
        if self._first is None:
            self._first = tick, self._clock.now_ns()
        self._last_tick = tick
        self._on_tick(tick)

    @property
    def ticks_per_s(self) -> float:
        """Until now; 0 before two ticks are done."""
        if self._first is None:
            return 0.0
        elapsed_ns = self._clock.now_ns() - self._first[1]
        return (self._last_tick - self._first[0]) * NS_PER_S / elapsed_ns if elapsed_ns else 0.0
