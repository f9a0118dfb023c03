"""The simulated car of a run: its actuators, late by the bus's latency, the plant, its sensor."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from can_rig.plant.actuators import Actuator, actuator_limits
from can_rig.plant.behind import plant_behind
from can_rig.plant.faults import ActuatorFault, SensorFault
from can_rig.plant.sensor import SensorNoise
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import limited, sensor_reading


class SimulatedPlant:
    """The car: two actuators, a latency line, a plant that commands are held for, a noisy sensor.

    Raises:
        ScenarioError: see ``plant_behind``.
    """

    def __init__(self, scenario: Scenario) -> None:
        hold_ticks = round(scenario.actuator.hold_s / scenario.tick_s)
        self._plant = plant_behind(scenario.plant, scenario.tick_s)
        self._tick = 0
        self._read = 0.0  # at rest
        self._fault = ActuatorFault(scenario)
        self._sensor = SensorFault(scenario)
        self._actuators = (Actuator(hold_ticks), Actuator(hold_ticks))
        self._on_the_way = deque([(0.0, 0.0)] * scenario.latency_ticks)
        limits = actuator_limits(scenario.plant, scenario.tick_s)
        self._limits = limits.tolist()
        self._is_limited = bool(np.isfinite(limits).any())
        self._reached = (0.0, 0.0)
        self._noise = SensorNoise(scenario)
        self._resolution = scenario.plant.sensor.resolution_mps2
        # Compile before the first tick needs it.
        sensor_reading(0.0, 0.0, 0.0, self._resolution)
        limited(0.0, 0.0, *self._limits[0])

    def measure(self) -> float:
        """D* as the sensor reads it now, m/s²."""
        bias = self._sensor.bias(self._tick)
        return float(sensor_reading(self._read, bias, self._noise.next(), self._resolution))

    def advance(
        self, tick: int, command_1: float | None, command_2: float | None
    ) -> Mapping[str, float]:
        """One tick on, with the valid commands of ``tick`` (None: there was none).

        Returns:
            The signals of ``tick`` that no frame carries.

        Raises:
            RigError: an exception in a plant that is the user's own.
        """
        self._tick = tick + 1
        left = self._fault.effectiveness(tick)
        acting = (self._actuators[0].hear(command_1), self._actuators[1].hear(command_2))
        self._on_the_way.append(acting)
        reached_1, reached_2 = self._on_the_way.popleft()
        if self._is_limited:
            reached_1 = float(limited(reached_1, self._reached[0], *self._limits[0]))
            reached_2 = float(limited(reached_2, self._reached[1], *self._limits[1]))
            self._reached = reached_1, reached_2
        signals = self._plant.report(reached_1, reached_2, *left)
        _, self._read = self._plant.follow(reached_1, reached_2, *left)
        return signals
