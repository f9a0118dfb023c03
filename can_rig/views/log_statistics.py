"""Statistics of a log: frames of each identifier, their cycles and gaps, and the load of each bus.

Everything is counted chunk by chunk; memory grows with the identifiers and with the seconds of the
recording, not with its frames.
"""

import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from can.util import dlc2len, len2dlc
from numpy.typing import NDArray

from can_rig.errors import LogError
from can_rig.frames.frame_length import worst_case_bits
from can_rig.logs.frames import (
    BITRATE_SWITCH,
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FD,
    FD_BYTES,
    NS_PER_S,
    REMOTE,
    Frames,
)

CYCLE_SAMPLES: Final = 4096
"""Number of intervals whose median is the cycle of an identifier."""

GAP_CYCLES: Final = 1.5
"""Longest interval without a gap, in cycles; beyond, at least one frame is missing."""


@dataclass
class Identifier:
    """Lengths, cycle and gaps of an identifier on a bus."""

    bus: str
    identifier: int
    is_extended: bool
    frames: int = 0
    shortest: int = FD_BYTES
    longest: int = 0
    """Payload lengths [byte]."""
    intervals: int = 0
    gaps: int = 0
    least_ns: int = 1 << 62
    most_ns: int = 0
    cycle_ns: float = math.nan
    """Median of the first `CYCLE_SAMPLES` intervals."""
    _last_ns: int | None = None
    _mean_ns: float = 0.0
    _squares: float = 0.0
    _early: list[NDArray[np.int64]] = field(default_factory=list)

    def add(self, time_ns: NDArray[np.int64], length: NDArray[np.uint8]) -> None:
        """Count later frames."""
        self.frames += len(time_ns)
        self.shortest = min(self.shortest, int(length.min()))
        self.longest = max(self.longest, int(length.max()))
        before = time_ns[:1] if self._last_ns is None else np.array([self._last_ns])
        steps = np.diff(time_ns, prepend=before)[1 if self._last_ns is None else 0 :]
        self._last_ns = int(time_ns[-1])
        if not len(steps):
            return
        self.least_ns = min(self.least_ns, int(steps.min()))
        self.most_ns = max(self.most_ns, int(steps.max()))
        # Sums of squares about the mean, of parts that are put together (Chan, Golub, LeVeque).
        mean, count = float(steps.mean()), self.intervals + len(steps)
        away = mean - self._mean_ns
        self._squares += float(((steps - mean) ** 2).sum())
        self._squares += away * away * self.intervals * len(steps) / count
        self._mean_ns += away * len(steps) / count
        self.intervals = count
        if math.isnan(self.cycle_ns):
            self._early.append(steps)
            if count >= CYCLE_SAMPLES:
                self.settle()
        else:
            self.gaps += int((steps > GAP_CYCLES * self.cycle_ns).sum())

    def settle(self) -> None:
        """Take the cycle from the intervals so far, and count the gaps among them."""
        if math.isnan(self.cycle_ns) and self._early:
            steps = np.concatenate(self._early)
            self.cycle_ns = float(np.median(steps[:CYCLE_SAMPLES]))
            self.gaps += int((steps > GAP_CYCLES * self.cycle_ns).sum())
            self._early.clear()

    @property
    def jitter_ns(self) -> float:
        """Standard deviation of the intervals."""
        return math.sqrt(self._squares / self.intervals) if self.intervals else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Every figure by its name; None for missing figures."""
        known = bool(self.intervals)
        ms = {
            "cycle_ms": self.cycle_ns,
            "jitter_ms": self.jitter_ns,
            "least_ms": self.least_ns,
            "most_ms": self.most_ns,
        }
        return {
            "bus": self.bus,
            "identifier": f"{self.identifier:0{8 if self.is_extended else 3}X}",
            "frames": self.frames,
            "bytes": [self.shortest, self.longest],
            **{name: value / 1e6 if known else None for name, value in ms.items()},
            "gaps": self.gaps,
        }


class LogStatistics:
    """Counts the frames of a log.

    Args:
        bitrate: nominal bit rate of every bus [bit/s].
        data_bitrate: bit rate of the data phase, for frames with bit rate switch [bit/s].

    Raises:
        FrameError: the bit rates are impossible.
    """

    def __init__(self, bitrate: int, data_bitrate: int) -> None:
        self._bit_rates = bitrate, data_bitrate
        self.duration_s(FD | BITRATE_SWITCH, 0)
        self.frames = self.error_frames = 0
        self.first_ns: int | None = None
        self.least_ns = self.last_ns = 0
        self.identifiers: dict[tuple[str, int, bool], Identifier] = {}
        self._busy: dict[str, defaultdict[int, float]] = {}

    def add(self, frames: Frames) -> None:
        """Count a chunk."""
        if not len(frames):
            return
        least_ns = int(frames.time_ns.min())
        if self.first_ns is None:
            self.first_ns = self.least_ns = least_ns
        self.frames += len(frames)
        self.least_ns = min(self.least_ns, least_ns)
        self.last_ns = max(self.last_ns, int(frames.time_ns.max()))
        errors = frames.has(ERROR)
        self.error_frames += int(errors.sum())
        if errors.any():
            frames = frames[~errors]
        extended = frames.has(EXTENDED)
        key = frames.arbitration_id.astype(np.uint64) | extended.astype(np.uint64) << np.uint64(30)
        key |= frames.channel.astype(np.uint64) << np.uint64(32)
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.diff(key[order], prepend=np.uint64((1 << 64) - 1)))
        for rows in np.split(order, starts[1:]) if len(order) else []:
            row = rows[0]
            bus = frames.channels[frames.channel[row]]
            name = bus, int(frames.arbitration_id[row]), bool(extended[row])
            found = self.identifiers.setdefault(name, Identifier(*name))
            found.add(frames.time_ns[rows], frames.length[rows])
        self._add_load(frames)

    def finish(self) -> None:
        """Complete the figures that need all frames."""
        for found in self.identifiers.values():
            found.settle()

    @property
    def span_s(self) -> float:
        """From the earliest frame to the latest [s]."""
        return (self.last_ns - self.least_ns) / NS_PER_S

    def load(self, bus: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Seconds since the first frame, and the upper bound of the busy share in each second.

        Seconds without frames are left out.
        """
        if bus not in self._busy:
            raise LogError(f"bus = {bus!r}: must be one of {', '.join(self.buses) or 'none'}")
        busy = sorted(self._busy[bus].items())
        return np.array([s for s, _ in busy], np.int64), np.array([share for _, share in busy])

    @property
    def buses(self) -> list[str]:
        """Buses with frames, in the order of first appearance."""
        return list(self._busy)

    def duration_s(self, flags: int, length: int) -> float:
        """How long a frame takes at most [s], with as many stuff bits as it can have."""
        fd = bool(flags & FD)
        bits = worst_case_bits(
            dlc2len(len2dlc(length)) if fd else min(length, CLASSIC_BYTES),
            extended=bool(flags & EXTENDED),
            remote=bool(flags & REMOTE),
            fd=fd,
            brs=bool(flags & BITRATE_SWITCH),
        )
        return float(bits.duration_s(*self._bit_rates))

    def _add_load(self, frames: Frames) -> None:
        assert self.first_ns is not None
        kinds, which = np.unique(
            frames.flags.astype(np.int64) << 8 | frames.length, return_inverse=True
        )
        each_s = np.array([self.duration_s(int(k) >> 8, int(k) & 0xFF) for k in kinds])
        busy_s = each_s[which] if len(kinds) else np.zeros(0)
        second = (frames.time_ns - self.first_ns) // NS_PER_S
        for at, bus in enumerate(frames.channels):
            here = frames.channel == at
            if here.any():
                seconds, place = np.unique(second[here], return_inverse=True)
                sums = np.bincount(place, busy_s[here])
                held = self._busy.setdefault(bus, defaultdict(float))
                for one, share in zip(seconds.tolist(), sums.tolist(), strict=True):
                    held[one] += share
