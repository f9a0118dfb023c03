"""The gaps of a log: every deviation of the frames from the sent sequence.

| gap             | meaning                                                                        |
|-----------------|--------------------------------------------------------------------------------|
| `missing`       | no frame of this message for the tick                                          |
| `late`          | the frame came after the begin of a later tick                                 |
| `out of order`  | the frame came in its tick, but after a later frame of the tick               |
| `repeated`      | the same frame again                                                           |
| `contradicting` | a different frame of the same message and tick                                 |
| `counter jump`  | the alive counter disagrees with the tick                                      |
| `wrong CRC`     | a damaged frame, or a frame of a foreign sender                                |
| `wrong length`  | not 8 bytes                                                                    |
| `stray tick`    | an intact frame of a tick far from the current tick                            |
| `clock step`    | the time stamps went back, or on by 0.1 s more than the ticks                  |
"""

import csv
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TextIO

from can_rig.frames.codec import COUNTERS, ROLES
from can_rig.frames.network import Network
from can_rig.logs.frames import NS_PER_S
from can_rig.replaying.rig_frames import SPEED_ROLE, RigFrame, is_input
from can_rig.scenario.fault_settings import Outage

NEAR: Final = 32
"""Largest distance of a usable frame from the current tick, in ticks."""

CLOCK_STEP_NS: Final = NS_PER_S // 10
COLUMNS: Final = ("tick", "time_s", "message", "what", "ticks", "detail")


class Gap(NamedTuple):
    """One deviation, in one tick or in successive ticks."""

    tick: int
    """First tick."""
    time_ns: int
    """First time stamp in the log."""
    message: str
    what: str
    """A word of the table above."""
    ticks: int = 1
    detail: str = ""


@dataclass
class Row:
    """The frames of one tick in a log."""

    time_ns: int
    seen: list[bytes | None] = field(default_factory=lambda: [None] * (len(ROLES) + 1))
    """By role, the first intact frame; the speed comes last."""
    damaged: set[int] = field(default_factory=set)
    """Roles with a damaged frame."""


class Account:
    """Collects the gaps, frame by frame.

    Args:
        network: names of the messages.
        tick_ns: expected step of the time stamps in a tick.
        outages: ticks of a controller without power: no answers, and counters begin anew.
    """

    def __init__(self, network: Network, tick_ns: int, outages: Sequence[Outage] = ()) -> None:
        self._outages = outages
        self._names = [codec.name for codec in network.by_role]
        self._lengths = [codec.layout.length for codec in network.by_role]
        self._tick_ns = tick_ns
        self.counts: Counter[tuple[str, str]] = Counter()
        """Number of gaps by message and word."""
        self.gaps: list[Gap] = []
        """After ``finish``: every gap by tick and time stamp; successive ticks are one gap."""
        self.first_input_gap: int | None = None
        """First tick from which on the replayed controller may lack inputs of the recorded
        controller."""
        self.first_answer_gap: int | None = None
        """First tick with a missing or late answer; in real time, the recorded controller may have
        continued without that answer."""
        self._runs: dict[tuple[str, str], Gap] = {}  # may continue in the next tick
        self._reached = (-1, -1)  # the furthest tick and role so far
        self._last: dict[int, tuple[int, int]] = {}  # role: tick and counter of the newest frame
        self._clock: tuple[int, int] | None = None  # tick and time stamp of the last frame

    def take(self, frame: RigFrame, row: Row | None, tick: int) -> None:
        """Judge a frame.

        Args:
            frame: the next frame of the log.
            row: the earlier frames of the tick; gets this frame; None: a stray tick.
            tick: the frame's tick; for a damaged or stray frame, the current tick.
        """
        role = frame.role
        if not frame.intact:
            whole = len(frame.data) == self._lengths[role]
            word = "wrong CRC" if whole else "wrong length"
            self.note(tick, frame.time_ns, role, word)
            if row is not None:
                row.damaged.add(role)
            return
        if row is None:
            self.note(tick, frame.time_ns, role, "stray tick", f"the frame says {frame.tick}")
            return
        self._watch_clock(frame, tick)
        before = row.seen[role]
        if before is not None:
            word = "repeated" if before == frame.data else "contradicting"
            self.note(tick, frame.time_ns, role, word)
            return
        row.seen[role] = frame.data
        place = -1 if role == SPEED_ROLE else role  # in the order on the bus
        if (tick, place) < self._reached:
            word = "late" if tick < self._reached[0] else "out of order"
            self.note(tick, frame.time_ns, role, word)
            return
        self._reached = (tick, place)
        self._watch_counter(frame, tick)

    def close(self, tick: int, row: Row) -> None:
        """Note the missing frames of ``tick``, which is over."""
        for role, data in enumerate(row.seen[: len(self._names)]):
            off = not is_input(role) and any(tick in outage for outage in self._outages)
            if data is None and role not in row.damaged and not off:
                self.note(tick, row.time_ns, role, "missing")

    def finish(self) -> None:
        """Complete ``gaps`` at the end of the log."""
        self.gaps += sorted(self._runs.values())
        self.gaps.sort(key=lambda gap: (gap.tick, gap.time_ns))
        self._runs.clear()

    def note(self, tick: int, time_ns: int, role: int, what: str, detail: str = "") -> None:
        """Count one gap; a negative ``role`` means the log itself."""
        name = self._names[role] if role >= 0 else "(time stamps)"
        key = (name, what)
        self.counts[key] += 1
        harmless = what == "repeated" or (what == "out of order" and role > 0)
        if role >= 0 and is_input(role) and not harmless:
            self.first_input_gap = _first(self.first_input_gap, tick)
        if role >= 0 and not is_input(role) and what in {"missing", "late"}:
            self.first_answer_gap = _first(self.first_answer_gap, tick)
        run = self._runs.get(key)
        if run is not None and not detail and run.tick + run.ticks == tick:
            self._runs[key] = run._replace(ticks=run.ticks + 1)
            return
        if run is not None:
            self.gaps.append(run)
        self._runs[key] = Gap(tick, time_ns, name, what, 1, detail)

    def _watch_counter(self, frame: RigFrame, tick: int) -> None:
        last = self._last.get(frame.role)
        self._last[frame.role] = (tick, frame.counter)
        restarted = (outage.stop for outage in self._outages if not is_input(frame.role))
        if last is None or any(last[0] < at <= tick for at in restarted):
            return
        wanted = (last[1] + tick - last[0]) % COUNTERS
        if frame.counter != wanted:
            detail = f"{frame.counter} in place of {wanted}"
            self.note(tick, frame.time_ns, frame.role, "counter jump", detail)

    def _watch_clock(self, frame: RigFrame, tick: int) -> None:
        before, self._clock = self._clock, (tick, frame.time_ns)
        if before is None:
            return
        step_ns = frame.time_ns - before[1]
        beyond_ns = step_ns - max(tick - before[0], 0) * self._tick_ns
        # Two swapped frames keep their time stamps: a step of a few ticks is no clock step.
        if step_ns < -(max(before[0] - tick, 0) + 1) * self._tick_ns or beyond_ns > CLOCK_STEP_NS:
            self.note(tick, frame.time_ns, -1, "clock step", f"{step_ns / NS_PER_S:+.6f} s")


def _first(known: int | None, tick: int) -> int:
    return tick if known is None else min(known, tick)


def write_gaps(file: TextIO, gaps: Iterable[Gap]) -> None:
    """Write gaps as CSV."""
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow(COLUMNS)
    rows.writerows((gap.tick, seconds(gap.time_ns), *gap[2:]) for gap in gaps)


def seconds(time_ns: int) -> str:
    """A time stamp in candump's form, with all digits."""
    sign, whole = "-" * (time_ns < 0), abs(time_ns)
    text = f"{sign}{whole // NS_PER_S}.{whole % NS_PER_S:09d}"
    return text[:-3] if text.endswith("000") else text
