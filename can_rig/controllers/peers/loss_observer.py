"""The lost share of channel 1 as the state of a Kalman filter.

With the healthy models w = G1 u1 and v = G2 u2, the residual w + v - y is s w plus noise. The share
s drifts as a random walk, so the filter has one state and a gain that grows with the excitation
(Zhang and Jiang, IEEE Trans. Control Systems Technology 10, 2002: actuator effectiveness as a state
of a Kalman filter).
"""

import math
from collections import deque
from typing import Final

import numpy as np

from can_rig.controllers.filters_law import sections_of
from can_rig.controllers.setup import ControllerSetup
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.filters import discretise
from firmware_model.law.status import FaultState

MODEL_ERROR: Final = 0.05
"""Share of w that the model does not explain."""
LEAST: Final = 0.1
"""The smallest share that counts as a loss."""


class Channel:
    """A plant's channel from the command of a tick, through the latency, to the output."""

    def __init__(self, g: ZeroPoleGain, tick_s: float, delay_ticks: int) -> None:
        _, self._a, self._b, self._c, _ = sections_of("", discretise(g, tick_s, "zoh"))
        self._x = np.zeros(len(self._b))
        self._waiting = deque([0.0] * delay_ticks)

    @property
    def output(self) -> float:
        """The output of this tick, before the command of this tick."""
        return float(self._c @ self._x)

    def advance(self, command: float) -> None:
        """Take in the command of this tick."""
        self._waiting.append(command)
        self._x = self._x + self._a @ self._x + self._b * self._waiting.popleft()


class LossObserver:
    """Models of both channels, and the lost share of the first.

    Parameters: ``share_drift``, rms of the share's change in a second.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        plant, tick_s = setup.plant, setup.tick_s
        late = [setup.latency_ticks + round(dead_s / tick_s) for dead_s in plant.path_dead_times_s]
        self.channels = Channel(plant.g1, tick_s, late[0]), Channel(plant.g2, tick_s, late[1])
        sensor = setup.scenario.model.sensor
        self._noise = max(math.hypot(sensor.noise_mps2, sensor.resolution_mps2), 1e-3) ** 2
        self._drift = setup.number("share_drift", 1.0) ** 2 * tick_s
        self.share, self.variance = 0.0, 1.0

    def observe(self, measurement: float) -> tuple[float, float]:
        """The healthy model's output of channel 1, and d̂ = s w."""
        w, v = (channel.output for channel in self.channels)
        noise = self._noise + (MODEL_ERROR * w) ** 2
        self.variance = min(self.variance + self._drift, 1.0)
        gain = self.variance * w / (w * w * self.variance + noise)
        self.share += gain * (w + v - measurement - self.share * w)
        self.share = min(max(self.share, 0.0), 1.0)
        self.variance *= 1.0 - gain * w
        return w, self.share * w

    def advance(self, command_1: float, command_2: float) -> None:
        """Take in the commands of this tick."""
        for channel, command in zip(self.channels, (command_1, command_2), strict=True):
            channel.advance(command)

    @property
    def fault_state(self) -> int:
        """What the share says about channel 1: the whole band of three sigmas decides."""
        band = 3.0 * math.sqrt(self.variance)
        if self.share - band > LEAST:
            return FaultState.CONFIRMED
        return FaultState.CANNOT_TELL if band > 1.0 else FaultState.CLEAR
