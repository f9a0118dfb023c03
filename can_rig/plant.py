"""The simulated plant behind its actuators: exact between ticks, late by the bus's latency."""

from __future__ import annotations

from collections import deque

import numpy as np

from can_rig.build import continuous_plant
from can_rig.faults import ActuatorFault
from can_rig.scenario import Scenario
from firmware_model.sampled_plant import advance_plant, measure_plant, sample


class Actuator:
    """Holds the last valid command for ``hold_ticks`` ticks without one, then applies zero."""

    def __init__(self, hold_ticks: int) -> None:
        self._hold_ticks = hold_ticks
        self._silent_ticks = 0
        self._command = 0.0

    def hear(self, command: float | None) -> float:
        """The command that acts, given this tick's valid command or None."""
        if command is not None:
            self._silent_ticks = 0
            self._command = command
        else:
            self._silent_ticks += 1
            if self._silent_ticks > self._hold_ticks:
                self._command = 0.0
        return self._command


class SimulatedPlant:
    """The car: two actuators, a latency line, the exactly sampled plant, a noisy sensor."""

    def __init__(self, scenario: Scenario) -> None:
        sampled = sample(continuous_plant(scenario.plant), scenario.tick_s)
        hold_ticks = round(scenario.actuator.hold_s / scenario.tick_s)
        self._phi, self._gamma, self._c = sampled.phi, sampled.gamma, sampled.c
        self._x = sampled.rest
        self._fault = ActuatorFault(scenario)
        self._actuators = (Actuator(hold_ticks), Actuator(hold_ticks))
        self._on_the_way = deque([(0.0, 0.0)] * scenario.latency_ticks)
        self._noise_rms = scenario.noise.dstar_rms_mps2
        self._random = np.random.Generator(np.random.PCG64(scenario.seed))

    def measure(self) -> float:
        """D* as the sensor reads it now, m/s²."""
        y = float(measure_plant(self._c, self._x))
        if self._noise_rms > 0.0:
            y += self._noise_rms * float(self._random.standard_normal())
        return y

    def advance(self, tick: int, command_1: float | None, command_2: float | None) -> None:
        """One tick on, with the valid commands of ``tick`` (None: there was none)."""
        left_1, left_2 = self._fault.effectiveness(tick)
        acting = (self._actuators[0].hear(command_1), self._actuators[1].hear(command_2))
        self._on_the_way.append(acting)
        u1, u2 = self._on_the_way.popleft()
        advance_plant(self._phi, self._gamma, self._x, left_1 * u1, left_2 * u2)
