"""The rig's source of time: one clock, passed as an argument, so tests control the time."""

from __future__ import annotations

import time
from typing import Protocol

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
