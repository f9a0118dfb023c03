"""The worst-case response time of every frame on a bus, by the revised analysis.

Davis, Burns, Bril, Lukkien: "Controller Area Network (CAN) schedulability analysis: Refuted,
revisited and revised", Real-Time Systems 35 (2007). They refute that the first instance after the
critical instant has the longest response: nothing pre-empts a frame on the bus, so waiting frames
delay the next instance. All instances of the busy period count.

For frame m with transmission time C, period T, queuing jitter J, the frames of higher priority
hp(m), those of lower priority lp(m), and one nominal bit τ:

    B      = max C_k over lp(m)                                   one of them has just begun
    t      = E(t) + B + Σ_{hp(m), m} ⌈(t + J_k) / T_k⌉ C_k        busy period at this priority
    Q      = ⌈(t + J) / T⌉                                        instances of m in it
    w(q)   = E(w + C) + B + q C + Σ_{hp(m)} ⌈(w + J_k + τ) / T_k⌉ C_k
    R      = max_{q < Q} (J + w(q) - q T + C)
    E(t)   = (31 τ + max C_k over hp(m), m) (burst - 1 + ⌈t / every⌉)   errors; 0 without any

C includes the intermission, so R does too. Every node must send its queued frame of the highest
priority first; J covers a node that queues m late.

All times become whole multiples of a common unit: the ceilings are exact, and rounding adds no
instance.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import chain, pairwise
from typing import Final, NamedTuple

from can_rig.assessment.bus_timing.frame_length import FrameBits
from can_rig.errors import RigError

ERROR_BITS: Final = 31
"""Most bits of error signalling and recovery, in addition to the frame sent again."""

Seconds = float | Fraction
"""A time [s]; a float stands for its printed decimal: 0.1 is exactly a tenth."""


class AnalysisError(RigError):
    """Frames that cannot be analysed: a bad period, two frames of the same priority."""


@dataclass(frozen=True)
class PeriodicFrame:
    """A frame with its node's queueing parameters."""

    name: str
    frame_id: int
    bits: FrameBits
    """Worst-case length."""
    period_s: Seconds
    """Shortest time between two releases [s]."""
    jitter_s: Seconds = 0.0
    """Longest time from release to queueing [s]."""
    deadline_s: Seconds | None = None
    """Latest end of the transmission after the release [s]; None: the period."""
    extended: bool = False
    """Whether the identifier has 29 bits."""

    @property
    def priority(self) -> tuple[int, bool, int]:
        """What arbitration compares bit by bit; the lower wins.

        If the first 11 bits are equal an 11-bit identifier wins, by its dominant RTR and IDE.
        """
        if self.extended:
            return (self.frame_id >> 18, True, self.frame_id & 0x3FFFF)
        return (self.frame_id, False, 0)


@dataclass(frozen=True)
class Errors:
    """`burst` errors at once, followed by at most one error per `every_s` seconds."""

    every_s: Seconds
    burst: int = 1


@dataclass(frozen=True)
class Response:
    """The result for one frame; all times in seconds, exact."""

    frame: PeriodicFrame
    transmission_s: Fraction
    blocking_s: Fraction
    instances: int
    """Instances of the frame in the busy period; 0 if that is unbounded."""
    busy_period_s: Fraction | None
    """None: the bus is never free at this priority; the frame may wait for ever."""
    response_s: Fraction | None
    """From the release to the end of the intermission after the frame; None: unbounded."""

    @property
    def slack_s(self) -> Fraction | None:
        """Deadline minus response [s], negative where it is missed; None: unbounded."""
        if self.response_s is None:
            return None
        deadline = self.frame.deadline_s
        return exact(self.frame.period_s if deadline is None else deadline) - self.response_s

    @property
    def schedulable(self) -> bool:
        """Whether the frame always meets its deadline."""
        return self.slack_s is not None and self.slack_s >= 0


def exact(seconds: Seconds) -> Fraction:
    """A float as its printed decimal; a Fraction unchanged."""
    return Fraction(repr(seconds)) if isinstance(seconds, float) else Fraction(seconds)


def utilisation(
    frames: Sequence[PeriodicFrame], bitrate: int, data_bitrate: int | None = None
) -> Fraction:
    """Share of time with a busy bus, Σ C / T; above 1 the bus is overloaded."""
    shares = (f.bits.duration_s(bitrate, data_bitrate) / exact(f.period_s) for f in frames)
    return sum(shares, Fraction(0))


def response_times(
    frames: Sequence[PeriodicFrame],
    bitrate: int,
    data_bitrate: int | None = None,
    errors: Errors | None = None,
) -> list[Response]:
    """The worst-case response of each frame, in order of priority.

    Args:
        frames: all frames on the bus, in any order.
        bitrate: nominal bit rate [bit/s].
        data_bitrate: of the data phase [bit/s], where frames switch.
        errors: how often frames are destroyed; None: never.

    Raises:
        AnalysisError: a period not above 0, a jitter below 0, two frames with one identifier.
        FrameError: a bad bit rate.
    """
    ordered = sorted(frames, key=lambda frame: frame.priority)
    _require_sound(ordered, errors)
    times = [
        (f.bits.duration_s(bitrate, data_bitrate), exact(f.period_s), exact(f.jitter_s))
        for f in ordered
    ]
    bit = Fraction(1, bitrate)
    every = exact(errors.every_s) if errors else Fraction(1)
    exact_times = (bit, every, *chain.from_iterable(times))
    per_s = math.lcm(*(time.denominator for time in exact_times))  # units in a second
    loads = [_Load(*(int(time * per_s) for time in three)) for three in times]
    found = []
    for m, frame in enumerate(ordered):
        blocking = max((other.transmission for other in loads[m + 1 :]), default=0)
        analysis = _Analysis(loads[:m], loads[m], blocking, int(bit * per_s))
        if errors:
            analysis = analysis.disturbed(int(every * per_s), errors.burst)
        busy, instances, response = analysis.worst()
        seconds = (None if t is None else Fraction(t, per_s) for t in (busy, response))
        found.append(Response(frame, times[m][0], Fraction(blocking, per_s), instances, *seconds))
    return found


def _require_sound(ordered: Sequence[PeriodicFrame], errors: Errors | None) -> None:
    for frame in ordered:
        period, jitter = float(frame.period_s), float(frame.jitter_s)
        if not (0.0 < period < math.inf and 0.0 <= jitter < math.inf):
            raise AnalysisError(
                f"{frame.name}: period {period:g} s, jitter {jitter:g} s: "
                "the period must be above 0, the jitter 0 or above"
            )
    for one, other in pairwise(ordered):
        if one.priority == other.priority:
            raise AnalysisError(
                f"{one.name} and {other.name} both have identifier 0x{one.frame_id:X}; "
                "identifiers must differ"
            )
    if errors and not (0 < errors.every_s < math.inf and errors.burst >= 1):
        raise AnalysisError(
            f"errors: {errors.burst} at once, one every {float(errors.every_s):g} s: "
            "must be 1 or more, at an interval above 0"
        )


class _Load(NamedTuple):
    """What recurs, in units of time."""

    transmission: int
    period: int
    jitter: int


@dataclass(frozen=True)
class _Analysis:
    """The module's equations for one frame `own`, in units of time."""

    higher: Sequence[_Load]
    own: _Load
    blocking: int
    bit: int
    errors: Sequence[_Load] = ()

    def disturbed(self, every: int, burst: int) -> "_Analysis":
        """The same with errors: E(t) is the demand of a load whose jitter causes the burst."""
        again = max(load.transmission for load in (*self.higher, self.own))
        errors = _Load(ERROR_BITS * self.bit + again, every, (burst - 1) * every)
        return replace(self, errors=[errors])

    def worst(self) -> tuple[int | None, int, int | None]:
        """t, Q and R; None, 0 and None for an endless busy period."""
        own = self.own
        everything = [*self.errors, *self.higher, own]
        share = sum(Fraction(load.transmission, load.period) for load in everything)
        once = self.blocking > 0 or any(load.jitter for load in everything)
        if share > 1 or (share == 1 and once):  # a backlog is never worked off
            return None, 0, None
        busy = _least(own.transmission, lambda t: self.blocking + _demand(everything, t))
        instances = _times(busy + own.jitter, own.period)
        response, w = 0, self.blocking
        for q in range(instances):
            w = _least(w, partial(self._sent_before, earlier=q))  # never below the last one's
            response = max(response, own.jitter + w - q * own.period + own.transmission)
        return busy, instances, response

    def _sent_before(self, w: int, earlier: int) -> int:
        """The right-hand side of w(q), `earlier` being q."""
        disturbed = _demand(self.errors, w + self.own.transmission)
        own = self.blocking + earlier * self.own.transmission
        return disturbed + own + _demand(self.higher, w + self.bit)


def _times(t: int, period: int) -> int:
    """⌈t / period⌉."""
    return -(-t // period)


def _demand(loads: Sequence[_Load], t: int) -> int:
    """The largest amount that `loads` queue in a window of length t, jitter included."""
    return sum(_times(t + load.jitter, load.period) * load.transmission for load in loads)


def _least(start: int, step: Callable[[int], int]) -> int:
    """The least fixed point of a monotonic `step`, from a `start` at or below the fixed point."""
    t = start
    while (longer := step(t)) > t:
        t = longer
    return t
