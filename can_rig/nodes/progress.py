"""How a run says how far it is: to whoever shows it, and not more often than is worth it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Final

from can_rig.nodes.clock import NS_PER_S, SYSTEM_CLOCK, Clock

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
