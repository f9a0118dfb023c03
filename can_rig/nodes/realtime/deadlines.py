"""Absolute deadlines of a real-time run.

Deadline k is start + k·T in whole nanoseconds of CLOCK_MONOTONIC. No deadline depends on the
previous tick, so a late tick delays no other tick, and the mean period equals the clock's period.

The wait is an ordinary sleep (``time.sleep`` is clock_nanosleep since Python 3.11) with a timer
slack of 1 ns. Spinning for the last 60 µs would bring the median lateness from some 20 µs to below
1 µs. Missed deadlines come from the tail of the distribution, which other processes cause and
spinning leaves unchanged; and on a shared core a spinning node takes time from the other node.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from can_rig.errors import ScenarioError
from can_rig.scenario.settings import Scenario

CATCH_UP_TICKS: Final = 5
"""Missed ticks that are made up for at once; ten frames, the transmit queue of a SocketCAN
interface (txqueuelen 10)."""


@dataclass(frozen=True)
class Schedule:
    """The deadlines of a run."""

    start_ns: int
    tick_ns: int

    def deadline_ns(self, tick: int) -> int:
        """When ``tick`` is due."""
        return self.start_ns + tick * self.tick_ns

    def newest(self, now_ns: int) -> int:
        """The last tick with a deadline at or before ``now_ns``."""
        return (now_ns - self.start_ns) // self.tick_ns


def require_causal(scenario: Scenario) -> None:
    """Refuse a run without a causal order in wall-clock time.

    Raises:
        ScenarioError: a latency of zero ticks.
    """
    if scenario.latency_ticks == 0:
        raise ScenarioError(
            f"scenario {scenario.name}: latency_ticks = 0: in real time a command acts from the "
            "next tick on at the earliest; it must be 1 or more, as in the scenario default or "
            "with --set latency_ticks=1"
        )
