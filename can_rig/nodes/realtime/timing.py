"""Absolute deadlines of a real-time run, and how they were met.

Deadline k is start + k·T in whole nanoseconds of CLOCK_MONOTONIC. No deadline depends on the
previous tick, so a late tick delays no other tick, and the mean period equals the clock's period.

The wait is an ordinary sleep (``time.sleep`` is clock_nanosleep since Python 3.11) with a timer
slack of 1 ns. Spinning for the last 60 µs would bring the median lateness from some 20 µs to below
1 µs. Missed deadlines come from the tail of the distribution, which other processes cause and
spinning leaves unchanged; and on a shared core a spinning node takes time from the other node.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np

from can_rig.errors import ScenarioError
from can_rig.scenario.fault_settings import RESTARTED
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
    if scenario.outages:
        raise ScenarioError(
            f"scenario {scenario.name}: fault.kind = {RESTARTED!r}: must be in lockstep, where a "
            "node knows the tick of its outage; in real time end the controller node and start "
            "another with can-rig controller --realtime"
        )


LONGEST_US: Final = 100_000  # of a histogram; longer durations count in the last bin
EDGES_US: Final = (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000)


class Histogram:
    """Durations in bins of 1 µs, so the memory does not depend on the length of the run."""

    def __init__(self) -> None:
        self._counts = np.zeros(LONGEST_US + 1, np.int64)
        self._longest_ns = 0

    def add(self, duration_ns: int) -> None:
        """Count one; a negative one as zero."""
        us = duration_ns // 1000
        self._counts[min(max(us, 0), LONGEST_US)] += 1
        self._longest_ns = max(self._longest_ns, duration_ns)

    def percentile_us(self, percent: float) -> float:
        """Upper bound of ``percent`` of the durations, to 1 µs, rounded up; 0 without data."""
        total = int(self._counts.sum())
        if total == 0:
            return 0.0
        rank = max(1, -int(-total * percent // 100))
        at = int(np.searchsorted(np.cumsum(self._counts), rank))
        return min(at + 1.0, self.max_us) if at < LONGEST_US else self.max_us

    @property
    def max_us(self) -> float:
        """The longest, exactly."""
        return self._longest_ns / 1000

    def as_dict(self) -> dict[str, Any]:
        """Percentiles, and counts between ``edges_us``; the last one is open."""
        edges = [0, *EDGES_US, LONGEST_US + 1]
        return {
            "p50": self.percentile_us(50.0),
            "p99": self.percentile_us(99.0),
            "p99.9": self.percentile_us(99.9),
            "max": self.max_us,
            "edges_us": [0, *EDGES_US],
            "counts": [int(self._counts[low:high].sum()) for low, high in pairwise(edges)],
        }


@dataclass
class Timing:
    """Deadline statistics of one run, in constant memory.

    ``missed_deadlines`` counts ticks begun a tick or more late, and all skipped ticks;
    ``skipped_ticks`` counts ticks never begun, more than ``CATCH_UP_TICKS`` late.
    ``unanswered_ticks`` lacked a command at the time of effect.
    """

    tick_ns: int
    missed_deadlines: int = 0
    skipped_ticks: int = 0
    unanswered_ticks: int = 0
    wake_up: Histogram = field(default_factory=Histogram)
    answer: Histogram = field(default_factory=Histogram)
    _met: int = 0
    _first: tuple[int, int] = (0, 0)
    _last: tuple[int, int] = (0, 0)
    _sums: list[int] = field(default_factory=lambda: [0, 0, 0, 0])

    def woke(self, tick: int, late_ns: int) -> None:
        """Record the start of ``tick``, ``late_ns`` after its deadline."""
        self.wake_up.add(late_ns)
        if late_ns >= self.tick_ns:
            self.missed_deadlines += 1
        if self._met == 0:
            self._first = (tick, late_ns)
        self._last = (tick, late_ns)
        self._met += 1
        for at, term in enumerate((tick, late_ns, tick * tick, tick * late_ns)):
            self._sums[at] += term

    def skipped(self, ticks: int) -> None:
        """Record the number of unsent ticks after the last wake-up."""
        self.missed_deadlines += max(0, ticks - 1)  # the first one counted when the node woke
        self.skipped_ticks += ticks

    @property
    def period_error_ppm(self) -> float | None:
        """(last - first wake-up)/ticks against the tick; its ends jitter as every wake-up does."""
        ticks = self._last[0] - self._first[0]
        if ticks == 0:
            return None
        return (self._last[1] - self._first[1]) / (ticks * self.tick_ns) * 1e6

    @property
    def drift_ppm(self) -> float | None:
        """Slope of the least-squares line through all wake-ups, against the tick."""
        n, (ticks, late, squares, products) = self._met, self._sums
        spread = n * squares - ticks * ticks
        if spread == 0:
            return None
        return (n * products - ticks * late) / (spread * self.tick_ns) * 1e6

    def as_dict(self) -> dict[str, Any]:
        """The section ``realtime`` of ``run.json``."""
        return {
            "period_error_ppm": self.period_error_ppm,
            "drift_ppm": self.drift_ppm,
            "missed_deadlines": self.missed_deadlines,
            "skipped_ticks": self.skipped_ticks,
            "unanswered_ticks": self.unanswered_ticks,
            "wake_up_lateness_us": self.wake_up.as_dict(),
            "answer_after_us": self.answer.as_dict(),
        }


def rows(realtime: dict[str, Any]) -> list[tuple[str, str]]:
    """The closing table of a real-time run, label and text; none of a controller node's own."""
    table: list[tuple[str, str]] = []
    if "wake_up_lateness_us" not in realtime:
        return table
    for key, label in (
        ("wake_up_lateness_us", "wake-up lateness, 50/99/99.9 %/max"),
        ("answer_after_us", "answer after, 50/99/99.9 %/max"),
    ):
        figures = realtime[key]
        values = " / ".join(f"{figures[name]:.0f}" for name in ("p50", "p99", "p99.9", "max"))
        table.append((label, f"{values} µs"))
    if realtime["period_error_ppm"] is not None:
        error, drift = realtime["period_error_ppm"], realtime["drift_ppm"]
        table.append(("mean period, drift", f"{error:+.3f} ppm, {drift:+.3f} ppm"))
    missed, skipped = realtime["missed_deadlines"], realtime["skipped_ticks"]
    table.append(("deadlines missed", f"{missed}, {skipped} ticks skipped"))
    unanswered, late = realtime["unanswered_ticks"], realtime["late_frames"]
    table.append(("ticks without a command in time", f"{unanswered}, {late} frames late"))
    return table


def scheduling_lines(realtime: dict[str, Any]) -> list[str]:
    """The services granted to each node by the operating system, one line a node."""
    return [f"{node} node: {text}" for node, text in realtime.get("scheduling", {}).items()]
