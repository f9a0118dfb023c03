"""Scheduled faults: a dead actuator or a biased sensor in the plant, frames lost or corrupted."""

from __future__ import annotations

import random

import can
import numpy as np

from can_rig.scenario.settings import CHANNELS, Scenario
from firmware_model.target.structs import FloatArray


class ActuatorFault:
    """What is left of each actuator's effect, by tick."""

    def __init__(self, scenario: Scenario) -> None:
        self._fault = scenario.fault if scenario.fault.kind == "actuator-dead" else None
        self._tick_ns = scenario.tick_ns
        self._channel = CHANNELS.index(scenario.fault.channel)

    def effectiveness(self, tick: int) -> tuple[float, float]:
        """Factor on command 1 and command 2 at ``tick``: 1 healthy, ``fault.left`` dead."""
        if self._fault is None or not self._fault.active(tick * self._tick_ns):
            return 1.0, 1.0
        left = self._fault.left
        return (left, 1.0) if self._channel == 0 else (1.0, left)


class SensorFault:
    """What a biased sensor adds to D*, by tick."""

    def __init__(self, scenario: Scenario) -> None:
        self._fault = scenario.fault if scenario.fault.kind == "sensor-biased" else None
        self._tick_ns = scenario.tick_ns

    def bias(self, tick: int) -> float:
        """m/s² at ``tick``."""
        if self._fault is None or not self._fault.active(tick * self._tick_ns):
            return 0.0
        return self._fault.bias_mps2


def effectiveness(scenario: Scenario) -> FloatArray:
    """(ticks, 2), what is left of each actuator at every tick of a run; see ``ActuatorFault``."""
    fault, left = scenario.fault, np.ones((scenario.ticks, 2))
    if fault.kind == "actuator-dead":
        left[fault.active_ticks(scenario.tick_ns), CHANNELS.index(fault.channel)] = fault.left
    return left


def bias(scenario: Scenario) -> FloatArray:
    """(ticks,), what a biased sensor adds to D* at every tick of a run, m/s²."""
    fault, added = scenario.fault, np.zeros(scenario.ticks)
    if fault.kind == "sensor-biased":
        added[fault.active_ticks(scenario.tick_ns)] = fault.bias_mps2
    return added


class FrameFault:
    """Commands that are not sent, or sent with one byte changed after protection."""

    def __init__(self, scenario: Scenario) -> None:
        kind = scenario.fault.kind
        self._fault = scenario.fault if kind.startswith("frames-") else None
        self._corrupt = kind == "frames-corrupted"
        self._tick_ns = scenario.tick_ns
        self._channel = CHANNELS.index(scenario.fault.channel)
        self._random = random.Random(scenario.seed)

    def concerns(self, channel: int) -> bool:
        """Whether frames of command ``channel`` (0, 1) are lost or damaged at some time."""
        return self._fault is not None and channel == self._channel

    def on_the_wire(self, frame: can.Message, channel: int, tick: int) -> can.Message | None:
        """The frame of command ``channel`` (0, 1) as it leaves the node; None when it does not.

        One changed byte is a burst of at most 8 bits, which a CRC-8 always detects, so a corrupted
        frame is never taken for a good one by luck.
        """
        fault = self._fault
        if fault is None or channel != self._channel:
            return frame
        if not fault.active(tick * self._tick_ns):
            return frame
        if not self._corrupt:
            return None
        frame.data[self._random.randrange(len(frame.data))] ^= self._random.randrange(1, 256)
        return frame
