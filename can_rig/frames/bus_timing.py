"""The worst-case response time of every frame on a bus, by the revised analysis.

Davis, Burns, Bril, Lukkien: "Controller Area Network (CAN) schedulability analysis: Refuted,
revisited and revised", Real-Time Systems 35 (2007). They refute that the first instance after the
critical instant has the longest response: nothing pre-empts a frame on the bus, so waiting frames
delay the next instance. All instances of the busy period count.

For frame m with transmission time C, period T, queuing jitter J, the frames of higher priority
hp(m), those of lower priority lp(m), and one nominal bit τ:

    B      = max C_k over lp(m)                                   one of them has just begun
    t      = B + Σ_{hp(m), m} ⌈(t + J_k) / T_k⌉ C_k        busy period at this priority
    Q      = ⌈(t + J) / T⌉                                        instances of m in it
    w(q)   = B + q C + Σ_{hp(m)} ⌈(w + J_k + τ) / T_k⌉ C_k
    R      = max_{q < Q} (J + w(q) - q T + C)

C includes the intermission, so R does too. Every node must send its queued frame of the highest
priority first; J covers a node that queues m late.

All times become whole multiples of a common unit: the ceilings are exact, and rounding adds no
instance.

When the frames of a tick arrive, and the latency in ticks that follows.

D* is sampled at the start of the tick and the plant's two frames are queued. The controller has
both after their worst-case response, computes for `compute_s`, and queues its three frames. The
period of all five is the tick; nothing else is on the bus.

If the last answer is sent before the tick ends, every tick finds the bus free, so each group is
analysed by itself; further sensors that the answers overtake may be the last of the tick. Otherwise
all frames are analysed together at any phase: the controller queues its answers between the start
of the tick and the moment above; this range is their jitter.

A command that has arrived acts from the start of the next tick, so the latency in ticks is the
arrival of the later command over the tick, rounded up: 1 where the exchange fits in a tick.
"""

import math
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, pairwise
from pathlib import Path
from typing import Final, NamedTuple

from cantools.database.can import Message as DbcMessage

from can_rig.errors import DbcError, RigError
from can_rig.frames.codec import MessageCodec
from can_rig.frames.databases import load_database
from can_rig.frames.foreign_frames import FD_LENGTHS
from can_rig.frames.frame_length import CLASSIC_BYTES, FrameBits, worst_case_bits
from can_rig.frames.network import Network

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
class FrameTiming:
    """One frame on the bus; times in seconds, exact."""

    name: str
    frame_id: int
    extended: bool
    bits: int
    """Worst case, with the intermission."""
    transmission_s: Fraction
    """Time for that many bits."""
    release_s: Fraction
    """Latest time, after the start of its period, at which the node queues the frame."""
    response_s: Fraction | None
    """Worst case from the release to the end of the intermission; None: unbounded."""
    deadline_s: Fraction
    """Largest allowed response: the period, at whose end the next instance is queued."""

    @property
    def arrival_s(self) -> Fraction | None:
        """Latest end of the frame, after the start of its period."""
        return None if self.response_s is None else self.release_s + self.response_s

    @property
    def slack_s(self) -> Fraction | None:
        """Deadline minus response, negative for a missed deadline."""
        return None if self.response_s is None else self.deadline_s - self.response_s


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
    frames: Sequence[PeriodicFrame], bitrate: int, data_bitrate: int | None = None
) -> list[FrameTiming]:
    """The worst case of each frame, in order of priority; the jitter is its release.

    Args:
        frames: all frames on the bus, in any order.
        bitrate: nominal bit rate [bit/s].
        data_bitrate: of the data phase [bit/s], where frames switch.

    Raises:
        AnalysisError: a period not above 0, a jitter below 0, two frames with one identifier.
        FrameError: a bad bit rate.
    """
    ordered = sorted(frames, key=lambda frame: frame.priority)
    _require_sound(ordered)
    times = [
        (f.bits.duration_s(bitrate, data_bitrate), exact(f.period_s), exact(f.jitter_s))
        for f in ordered
    ]
    bit = Fraction(1, bitrate)
    exact_times = (bit, *chain.from_iterable(times))
    per_s = math.lcm(*(time.denominator for time in exact_times))  # units in a second
    loads = [_Load(*(int(time * per_s) for time in three)) for three in times]
    found = []
    for m, frame in enumerate(ordered):
        blocking = max((other.transmission for other in loads[m + 1 :]), default=0)
        response = _worst(loads[:m], loads[m], blocking, int(bit * per_s))
        transmission_s, period_s, jitter_s = times[m]
        found.append(
            FrameTiming(
                name=frame.name,
                frame_id=frame.frame_id,
                extended=frame.extended,
                bits=frame.bits.on_the_bus,
                transmission_s=transmission_s,
                release_s=jitter_s,
                response_s=None if response is None else Fraction(response, per_s) - jitter_s,
                deadline_s=period_s,
            )
        )
    return found


def _require_sound(ordered: Sequence[PeriodicFrame]) -> None:
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


class _Load(NamedTuple):
    """What recurs, in units of time."""

    transmission: int
    period: int
    jitter: int


def _worst(higher: Sequence[_Load], own: _Load, blocking: int, bit: int) -> int | None:
    """R of the module's equations, in units of time; None where the busy period is endless."""
    everything = [*higher, own]
    share = sum(Fraction(load.transmission, load.period) for load in everything)
    once = blocking > 0 or any(load.jitter for load in everything)
    if share > 1 or (share == 1 and once):  # a backlog is never worked off
        return None
    busy = _least(own.transmission, blocking, everything)
    response, w = 0, blocking
    for q in range(_times(busy + own.jitter, own.period)):
        sent_before = blocking + q * own.transmission
        w = _least(w, sent_before, higher, bit)  # never below the last one's
        response = max(response, own.jitter + w - q * own.period + own.transmission)
    return response


def _times(t: int, period: int) -> int:
    """⌈t / period⌉."""
    return -(-t // period)


def _demand(loads: Sequence[_Load], t: int) -> int:
    """The largest amount that `loads` queue in a window of length t, jitter included."""
    return sum(_times(t + load.jitter, load.period) * load.transmission for load in loads)


def _least(start: int, fixed: int, loads: Sequence[_Load], bit: int = 0) -> int:
    """The least t = `fixed` + demand of `loads` in t + `bit`, from a `start` at or below t."""
    t = start
    while (longer := fixed + _demand(loads, t + bit)) > t:
        t = longer
    return t


MAX_SETTLING_TICKS: Final = 64  # more latency than a controller's table can hold


class TimingError(RigError):
    """A bus too slow to send a tick's frames within the tick."""


@dataclass(frozen=True)
class BusTiming:
    """All frames of a bus, the highest priority first."""

    bitrate: int
    utilisation: Fraction
    """Share of time with a busy bus, every frame at its longest."""
    frames: Sequence[FrameTiming]
    latency_ticks: int | None = None
    """From the sample of D* to the command acting; None: unbounded, or not the rig's frames."""
    left_out: Sequence[str] = ()
    """Messages left out of the analysis, each with the reason."""

    @property
    def schedulable(self) -> bool:
        """Whether every frame always meets its deadline."""
        return all(frame.slack_s is not None and frame.slack_s >= 0 for frame in self.frames)


def network_timing(
    network: Network, bitrate: int, tick_s: Seconds, compute_s: Seconds
) -> BusTiming:
    """The frames of a tick.

    Args:
        network: the frames.
        bitrate: of the bus [bit/s].
        tick_s: length of the tick [s].
        compute_s: most time from the arrival of D* until the controller queues its answer [s].
    """
    tick, compute = exact(tick_s), exact(compute_s)
    sensors = zip(network.witnesses, network.periods, strict=True)
    further = {codec.frame_id: (codec, tick * period) for codec, period in sensors}  # by message
    inputs = [_of_tick(codec, tick) for codec in network.inputs]
    plant = inputs + [_of_tick(*each) for each in further.values()]
    commands = [_of_tick(codec, tick) for codec in (network.command_1, network.command_2)]
    answers = [*commands, _of_tick(network.status, tick)]
    # The two groups, each by itself on the bus.
    measured = response_times(plant, bitrate)
    release = (_latest(measured) or 0) + compute
    answered = [replace(f, release_s=release) for f in response_times(answers, bitrate)]
    lowest = max(*(frame.priority for frame in inputs), min(frame.priority for frame in answers))
    overtaken = {frame.name for frame in plant if frame.priority > lowest}
    frames = _outranked([*measured, *answered], overtaken)
    last = _latest(frames)
    if last is None or last > tick:
        frames = _together(plant, answers, bitrate, compute)
    names = {command.name for command in commands}
    acts = _latest(frame for frame in frames if frame.name in names)
    timing = BusTiming(bitrate, utilisation([*plant, *answers], bitrate), frames)
    if acts is None or not timing.schedulable:
        return timing
    return replace(timing, latency_ticks=math.ceil(acts / tick))


def latency_ticks(network: Network, bitrate: int, tick_s: Seconds, compute_s: Seconds) -> int:
    """Whole ticks from the sample of D* until the commands computed from it act.

    Arguments as those of `network_timing`.

    Raises:
        TimingError: a frame may still wait while its successor is queued.
    """
    timing = network_timing(network, bitrate, tick_s, compute_s)
    if timing.latency_ticks is None:
        raise TimingError(
            f"{bitrate} bit/s: the frames of a tick of {float(tick_s) * 1e3:g} ms use "
            f"{float(timing.utilisation):.0%} of the bus and some may come too late; "
            "the bus or the controller must be faster, or the tick longer"
        )
    return timing.latency_ticks


def dbc_timing(path: str | Path, bitrate: int, data_bitrate: int | None = None) -> BusTiming:
    """All messages of any DBC, each sent every GenMsgCycleTime, by nodes without a common clock.

    Args:
        path: the DBC.
        bitrate: nominal bit rate [bit/s].
        data_bitrate: of the data phase [bit/s], to which every FD frame switches; None: none does.

    Raises:
        DbcError: not a DBC, or without a message to look at.
        AnalysisError, FrameError: frames or bit rates outside the CAN standard.
    """
    frames, left_out = [], []
    for message in load_database(path, strict=False).messages:
        longest = FD_LENGTHS[-1] if message.is_fd else CLASSIC_BYTES
        if not message.cycle_time:
            left_out.append(f"{message.name} (no cycle time)")
        elif message.length > longest:
            left_out.append(f"{message.name} ({message.length} bytes do not fit in a frame)")
        else:
            frames.append(_of_dbc(message, message.cycle_time, data_bitrate is not None))
    if not frames:
        without = ", ".join(left_out[:3]) or "it has no messages"
        raise DbcError(
            f"{path}: no message to look at: {without}; a message must have a GenMsgCycleTime "
            "above 0 ms, and fit in a frame"
        )
    timings = response_times(frames, bitrate, data_bitrate)
    taken = utilisation(frames, bitrate, data_bitrate)
    return BusTiming(bitrate, taken, timings, left_out=left_out)


def _of_tick(codec: MessageCodec, tick: Fraction) -> PeriodicFrame:
    bits = worst_case_bits(codec.layout.length, extended=codec.extended, fd=codec.fd)
    return PeriodicFrame(codec.name, codec.frame_id, bits, tick, extended=codec.extended)


def _of_dbc(message: DbcMessage, cycle_time_ms: int, switches: bool) -> PeriodicFrame:
    length = message.length
    if message.is_fd:  # the frame takes the next length with a DLC
        length = min(known for known in FD_LENGTHS if known >= length)
    extended = message.is_extended_frame
    bits = worst_case_bits(
        length, extended=extended, fd=message.is_fd, brs=message.is_fd and switches
    )
    period_s = exact(cycle_time_ms) / 1000
    return PeriodicFrame(message.name, message.frame_id, bits, period_s, extended=extended)


def _outranked(frames: Sequence[FrameTiming], overtaken: Container[str]) -> list[FrameTiming]:
    """The two groups, where the answers overtake further sensors that wait for the inputs.

    Such a frame is queued at the start of the tick and the bus is never idle before it is sent, so
    every other frame of the tick at most comes first.
    """
    whole = sum((frame.transmission_s for frame in frames), Fraction(0))
    return [
        replace(frame, response_s=whole)
        if frame.name in overtaken and frame.response_s is not None
        else frame
        for frame in frames
    ]


def _together(
    plant: Sequence[PeriodicFrame],
    answers: Sequence[PeriodicFrame],
    bitrate: int,
    compute: Fraction,
) -> list[FrameTiming]:
    """All five frames at any phase; the answers' jitter and the responses depend on each other."""
    names = {frame.name for frame in plant}
    release, limit = compute, MAX_SETTLING_TICKS * exact(plant[0].period_s)
    while True:
        late = [replace(frame, jitter_s=release) for frame in answers]
        frames = response_times([*plant, *late], bitrate)
        heard = _latest(frame for frame in frames if frame.name in names)
        if heard is None or heard + compute > limit:
            return [replace(frame, response_s=None) for frame in frames]
        if heard + compute == release:
            return frames
        release = heard + compute


def _latest(frames: Iterable[FrameTiming]) -> Fraction | None:
    """Arrival of the last of `frames`; None where one is unbounded."""
    latest = Fraction(0)
    for frame in frames:
        if frame.arrival_s is None:
            return None
        latest = max(latest, frame.arrival_s)
    return latest
