"""The sent frames of a run, and their receivers' verdicts.

Values play no part; sending and timing decide. The module asks the receivers themselves, because
their alive counters also reject frames right after an outage.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from can import Message
from numpy.typing import NDArray

from can_rig.frames.codec import MessageCodec
from can_rig.frames.endpoints import Receiver, Transmitter
from can_rig.frames.network import Network
from can_rig.plant.faults.frame_faults import SENSOR_PLACE, FrameFaults
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import BoolArray

SETTLED: Final = 20
"""Ticks until a receiver with uninterrupted frames again uses every frame."""


@dataclass(frozen=True)
class Delivery:
    """The fate of the frames that can fail.

    Attributes:
        sent: (ticks, 2), whether a command frame of a tick is on the bus.
        used: (ticks, 2), whether the actuator uses the command.
        damage: (n, 4), a row for each damaged command frame: tick, channel, byte, exclusive or of
            the byte.
        replaced: by tick and place (0 or 1: command, 2: D*), the used value in place of the sent
            value; nan: no value.
        rejected: by command name, the number of rejected frames for each reason.
    """

    sent: BoolArray
    used: BoolArray
    damage: NDArray[np.int64]
    replaced: dict[tuple[int, int], float]
    rejected: dict[str, dict[str, int]]


def delivery(scenario: Scenario, network: Network, ticks: int | None = None) -> Delivery:
    """The fate of the frames of the first ``ticks`` ticks; None: the whole run."""
    ticks = scenario.ticks if ticks is None else ticks
    sent, used = np.ones((2, ticks, 2), dtype=np.bool_)
    damage: list[tuple[int, int, int, int]] = []
    replaced: dict[tuple[int, int], float] = {}
    rejected: dict[str, dict[str, int]] = {}
    faults = FrameFaults(scenario, network)
    for channel, codec in enumerate((network.command_1, network.command_2)):
        transmitter, receiver = Transmitter(codec), Receiver(codec)
        for tick in _watched(faults, channel, ticks):
            own = transmitter.frame(math.nan, tick)
            frames = faults.on_the_wire(own, channel, tick)
            sent[tick, channel] = bool(frames)
            damage += [(tick, channel, *changed) for changed in _changes(own.data, frames)]
            records = [receiver.accept(frame, tick) for frame in frames]
            used[tick, channel] = any(record is not None for record in records)
            for record in records:
                # the rig's own frames carry no data here
                if record is not None and math.isfinite(record.value):
                    replaced[tick, channel] = record.value
            receiver.end_tick()
        rejected[codec.name] = receiver.rejected
    replaced |= _feedback(faults, network.feedback, ticks)
    return Delivery(
        sent, used, np.array(damage, dtype=np.int64).reshape(len(damage), 4), replaced, rejected
    )


def _feedback(faults: FrameFaults, codec: MessageCodec, ticks: int) -> dict[tuple[int, int], float]:
    """The controller's values in place of D*: the first usable frame of a tick counts."""
    replaced: dict[tuple[int, int], float] = {}
    transmitter, nothing, receiver = Transmitter(codec), Transmitter(codec), Receiver(codec)
    for tick in _watched(faults, SENSOR_PLACE, ticks):
        own, none = transmitter.frame(0.0, tick), nothing.frame(math.nan, tick)
        for frame in faults.on_the_wire(own, SENSOR_PLACE, tick, none):
            record = receiver.accept(frame, tick)
            if record is not None:
                if frame is not own:
                    replaced[tick, SENSOR_PLACE] = record.value
                break
        receiver.end_tick()
    return replaced


def _watched(faults: FrameFaults, place: int, ticks: int) -> range:
    """The ticks that need a look at every frame."""
    spans = [span for span in faults.ticks[place] if span]
    if not spans:
        return range(0)
    # One tick earlier the receiver has heard one frame; more earlier frames change nothing.
    first = max(min(span.start for span in spans) - 1, 0)
    return range(first, min(max(span.stop for span in spans) + SETTLED, ticks))


def _changes(own: bytearray, frames: list[Message]) -> Iterator[tuple[int, int]]:
    """Each changed byte of the sent frame, with its exclusive or."""
    for frame in frames[:1]:
        pairs = zip(own, frame.data, strict=True)
        yield from ((at, a ^ b) for at, (a, b) in enumerate(pairs) if a != b)
