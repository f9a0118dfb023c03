"""The sensor of D*: a dead time, a filter of first order, noise, a resolution.

A linear car includes dead time and filter in its matrix, exactly. The filter here serves plant
classes, which provide only samples.
"""

import math
from collections import deque

import numpy as np

from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import split_ticks
from firmware_model.compiled import compiled
from firmware_model.design.actuator_dynamics import Stage
from firmware_model.law.structs import FloatArray


class NoiseColumns:
    """The noise of a sensor, some ticks at a time.

    White noise, or noise coloured by the sensor's filter: n(k) = p n(k-1) + √(1 - p²) w(k), p =
    e^{-T/τ}. The rms describes the coloured noise, from the first tick on.

    Args:
        seed: the seed of the scenario, or for another sensor a seed derived from that seed.
        rms: of the noise.
        lag_s: of the filter that colours the noise; 0: white noise.
        tick_s: the tick, seconds.
    """

    def __init__(
        self, seed: int | np.random.SeedSequence, rms: float, lag_s: float, tick_s: float
    ) -> None:
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._rms = rms
        self._memory = math.exp(-tick_s / lag_s) if lag_s > 0.0 else 0.0
        self._last: float | None = None

    @classmethod
    def of(cls, scenario: Scenario) -> "NoiseColumns":
        """The noise on D* of a run of ``scenario``."""
        sensor = scenario.plant.sensor
        return cls(scenario.seed, sensor.noise_mps2, sensor.lag_s, scenario.tick_s)

    def next(self, ticks: int) -> FloatArray:
        """(ticks,), in the unit of the rms, of the next ones."""
        if self._rms == 0.0:
            return np.zeros(ticks)
        drawn: FloatArray = self._rms * self._random.standard_normal(ticks)
        if self._memory > 0.0 and ticks:
            memory = np.full(ticks, self._memory)
            if self._last is None:
                memory[:1] = 0.0  # a stationary start
            self._last = coloured(drawn, memory, self._last or 0.0)
        return drawn


@compiled
def coloured(drawn: FloatArray, memory: FloatArray, last: float) -> float:
    """Noise of first order from white noise, in place; ``last`` is the value before.

    Returns the last value.
    """
    for k in range(len(drawn)):
        last = memory[k] * last + math.sqrt(1.0 - memory[k] ** 2) * drawn[k]
        drawn[k] = last
    return last


class FilteredSamples:
    """Samples after a dead time and a filter; straight lines connect the samples.

    Args:
        stage: the sensor's lag and dead time.
        step_s: from sample to sample, seconds.
    """

    def __init__(self, stage: Stage, step_s: float) -> None:
        whole, part = split_ticks(stage.dead_time_s / step_s)
        self._samples = deque([0.0] * (whole + 2), maxlen=whole + 2)
        self._part = part
        self._tau = stage.lag_s / step_s
        self._delayed = self._filtered = 0.0

    def next(self, sample: float) -> float:
        """The sensor's present reading, from the present ``sample``."""
        self._samples.append(sample)
        newer, older = self._samples[1], self._samples[0]
        delayed = newer + self._part * (older - newer)
        if self._tau == 0.0:
            self._filtered = delayed
        else:  # exact for a straight line between samples
            fade = math.exp(-1.0 / self._tau)
            mean = self._tau * (1.0 - fade)
            self._filtered = (
                fade * self._filtered + (mean - fade) * self._delayed + (1.0 - mean) * delayed
            )
        self._delayed = delayed
        return self._filtered
