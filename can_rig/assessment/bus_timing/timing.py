"""When the frames of a tick arrive, and the latency in ticks that follows.

D* is sampled at the start of the tick and the plant's two frames are queued. The controller has
both after their worst-case response, computes for `compute_s`, and queues its three frames. The
period of all five is the tick; nothing else is on the bus.

If the last answer is sent before the tick ends, the two groups never meet: every tick finds the bus
free, so each group is analysed by itself. Otherwise all five frames are analysed together at any
phase: the controller queues its answers between the start of the tick and the moment above; this
range is their jitter.

A command that has arrived acts from the start of the next tick, so the latency in ticks is the
arrival of the later command over the tick, rounded up: 1 where the exchange fits in a tick.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Final

from cantools.database.can import Message as DbcMessage

from can_rig.assessment.bus_timing.frame_length import CLASSIC_BYTES, worst_case_bits
from can_rig.assessment.bus_timing.response_time import (
    PeriodicFrame,
    Response,
    Seconds,
    exact,
    response_times,
    utilisation,
)
from can_rig.errors import RigError
from can_rig.frames.codec import MessageCodec
from can_rig.frames.databases import load_dbc
from can_rig.frames.foreign_frames import FD_LENGTHS
from can_rig.frames.network import Network

MAX_SETTLING_TICKS: Final = 64  # more latency than a controller's table can hold


class TimingError(RigError):
    """A bus too slow to send a tick's frames within the tick."""


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
    """Latest time after the start of the tick at which the node queues the frame."""
    response_s: Fraction | None
    """Worst case from the release to the end of the intermission; None: unbounded."""
    deadline_s: Fraction
    """Largest allowed response: the period, at whose end the next instance is queued."""

    @property
    def arrival_s(self) -> Fraction | None:
        """Latest end of the frame, after the start of the tick."""
        return None if self.response_s is None else self.release_s + self.response_s

    @property
    def slack_s(self) -> Fraction | None:
        """Deadline minus response, negative for a missed deadline."""
        return None if self.response_s is None else self.deadline_s - self.response_s


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
    plant = [_of_tick(codec, tick) for codec in network.on_the_bus[: network.offered]]
    commands = [_of_tick(codec, tick) for codec in (network.command_1, network.command_2)]
    answers = [*commands, _of_tick(network.status, tick)]
    frames = _apart(plant, answers, bitrate, compute)
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
        DbcError: not a DBC.
        AnalysisError, FrameError: frames or bit rates outside the CAN standard.
    """
    frames, left_out = [], []
    for message in load_dbc(path, strict=False).messages:
        longest = FD_LENGTHS[-1] if message.is_fd else CLASSIC_BYTES
        if not message.cycle_time:
            left_out.append(f"{message.name} (no cycle time)")
        elif message.length > longest:
            left_out.append(f"{message.name} ({message.length} bytes do not fit in a frame)")
        else:
            frames.append(_of_dbc(message, message.cycle_time, data_bitrate is not None))
    responses = response_times(frames, bitrate, data_bitrate)
    taken = utilisation(frames, bitrate, data_bitrate)
    return BusTiming(bitrate, taken, [_timing(r) for r in responses], left_out=left_out)


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


def _apart(
    plant: Sequence[PeriodicFrame],
    answers: Sequence[PeriodicFrame],
    bitrate: int,
    compute: Fraction,
) -> list[FrameTiming]:
    """The two groups, each by itself on the bus."""
    measured = [_timing(response) for response in response_times(plant, bitrate)]
    release = (_latest(measured) or 0) + compute
    return [*measured, *(_timing(r, release) for r in response_times(answers, bitrate))]


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
        frames = [
            _timing(r, Fraction(0) if r.frame.name in names else release)
            for r in response_times([*plant, *late], bitrate)
        ]
        heard = _latest(frame for frame in frames if frame.name in names)
        if heard is None or heard + compute > limit:
            return [replace(frame, response_s=None) for frame in frames]
        if heard + compute == release:
            return frames
        release = heard + compute


def _timing(response: Response, release: Fraction = Fraction(0)) -> FrameTiming:
    frame = response.frame
    own = None if response.response_s is None else response.response_s - exact(frame.jitter_s)
    return FrameTiming(
        name=frame.name,
        frame_id=frame.frame_id,
        extended=frame.extended,
        bits=frame.bits.on_the_bus,
        transmission_s=response.transmission_s,
        release_s=release,
        response_s=own,
        deadline_s=exact(frame.period_s),
    )


def _latest(frames: Iterable[FrameTiming]) -> Fraction | None:
    """Arrival of the last of `frames`; None where one is unbounded."""
    latest = Fraction(0)
    for frame in frames:
        if frame.arrival_s is None:
            return None
        latest = max(latest, frame.arrival_s)
    return latest
