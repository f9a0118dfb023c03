"""Which command frames of a run are sent, and what the plant's receivers make of them.

Not what they say but that they were sent and when decides it: the receivers themselves are asked,
for the alive counter has its say when frames come again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from can_rig.frames.endpoints import Receiver, Transmitter
from can_rig.frames.network import Network
from can_rig.plant.faults import FrameFault
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import BoolArray

SETTLED: Final = 20
"""Ticks after which a receiver that has heard every frame again uses every frame."""


@dataclass(frozen=True)
class Delivery:
    """What becomes of the command frames.

    Attributes:
        sent: (ticks, 2), whether the frame of a tick is on the bus.
        used: (ticks, 2), whether it tells its actuator something.
        damage: (n, 4), of each frame that is damaged its tick, its channel, the byte, and the
            exclusive or of that.
        rejected: of each command by name, how many frames were not used, by reason.
    """

    sent: BoolArray
    used: BoolArray
    damage: NDArray[np.int64]
    rejected: dict[str, dict[str, int]]


def delivery(scenario: Scenario, network: Network, ticks: int | None = None) -> Delivery:
    """What becomes of the commands of the first ``ticks`` ticks; None: of the whole run."""
    ticks = scenario.ticks if ticks is None else ticks
    sent, used = np.ones((2, ticks, 2), dtype=np.bool_)
    damage: list[tuple[int, int, int, int]] = []
    rejected: dict[str, dict[str, int]] = {}
    fault, active = FrameFault(scenario), scenario.fault.active_ticks(scenario.tick_ns)
    # One tick before it the receiver has heard one frame, which is as good as having heard all.
    watched = range(max(active.start - 1, 0), min(active.stop + SETTLED, ticks))
    for channel, codec in enumerate((network.command_1, network.command_2)):
        rejected[codec.name] = {}
        if not fault.concerns(channel):
            continue
        transmitter, receiver = Transmitter(codec), Receiver(codec)
        for tick in watched:
            good = transmitter.frame(0.0, tick)
            before = bytes(good.data)
            frame = fault.on_the_wire(good, channel, tick)
            sent[tick, channel] = frame is not None
            if frame is not None and frame.data != before:
                at = next(at for at, byte in enumerate(before) if byte != frame.data[at])
                damage.append((tick, channel, at, before[at] ^ frame.data[at]))
            record = None if frame is None else receiver.accept(frame, tick)
            used[tick, channel] = record is not None
            receiver.end_tick()
        rejected[codec.name] = receiver.rejected
    return Delivery(sent, used, np.array(damage, dtype=np.int64).reshape(len(damage), 4), rejected)
