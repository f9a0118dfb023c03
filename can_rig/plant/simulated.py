"""The simulated plant behind its actuators: exact between ticks, late by the bus's latency."""

from __future__ import annotations

from collections import deque

import numpy as np

from can_rig.plant.faults import ActuatorFault, SensorFault
from can_rig.plant.protocol import GuardedPlant, PlantProtocol, load_plant
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import follow_plant, sample


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


class LinearPlant:
    """The plants of the thesis as a ``PlantProtocol``: exact for held commands.

    Raises:
        ScenarioError: parameters with which the car is not stable.
    """

    def __init__(self, settings: PlantSettings) -> None:
        self._plant = continuous_plant(settings)
        self._dt_s = 0.0  # what the matrices below are for; the first advance makes them
        self._phi = self._gamma = self._c = np.empty(0)
        self._x = np.zeros(len(self._plant.a))

    def reset(self) -> None:
        """Back to rest."""
        self._x[:] = 0.0

    def advance(self, dt_s: float, torque_nm: float, force_difference_n: float) -> float:
        """The output ``dt_s`` seconds later; of a plant that is no car it has no unit."""
        if dt_s != self._dt_s:
            sampled = sample(self._plant, dt_s)
            self._phi, self._gamma, self._c = sampled.phi, sampled.gamma, sampled.c
            self._dt_s = dt_s
        return float(
            follow_plant(self._phi, self._gamma, self._c, self._x, torque_nm, force_difference_n)
        )


def plant_of(settings: PlantSettings) -> PlantProtocol:
    """The plant that ``settings`` name, at rest.

    Raises:
        ScenarioError: a car that is not stable, a class that is no plant.
    """
    if settings.is_class:
        return GuardedPlant(settings.kind, load_plant(settings.kind, settings))
    return LinearPlant(settings)


class SimulatedPlant:
    """The car: two actuators, a latency line, a plant that commands are held for, a noisy sensor.

    Raises:
        ScenarioError: see ``plant_of``.
    """

    def __init__(self, scenario: Scenario) -> None:
        hold_ticks = round(scenario.actuator.hold_s / scenario.tick_s)
        self._plant = plant_of(scenario.plant)
        self._plant.advance(scenario.tick_s, 0.0, 0.0)  # compiles before the first tick needs it
        self._plant.reset()
        self._tick_s = scenario.tick_s
        self._tick = 0
        self._output = 0.0  # at rest
        self._fault = ActuatorFault(scenario)
        self._sensor = SensorFault(scenario)
        self._actuators = (Actuator(hold_ticks), Actuator(hold_ticks))
        self._on_the_way = deque([(0.0, 0.0)] * scenario.latency_ticks)
        self._noise_rms = scenario.noise.dstar_rms_mps2
        self._random = np.random.Generator(np.random.PCG64(scenario.seed))

    def measure(self) -> float:
        """D* as the sensor reads it now, m/s²."""
        y = self._output + self._sensor.bias(self._tick)
        if self._noise_rms > 0.0:
            y += self._noise_rms * float(self._random.standard_normal())
        return y

    def advance(self, tick: int, command_1: float | None, command_2: float | None) -> None:
        """One tick on, with the valid commands of ``tick`` (None: there was none).

        Raises:
            RigError: an exception in a plant that is the user's own.
        """
        self._tick = tick + 1
        left_1, left_2 = self._fault.effectiveness(tick)
        acting = (self._actuators[0].hear(command_1), self._actuators[1].hear(command_2))
        self._on_the_way.append(acting)
        u1, u2 = self._on_the_way.popleft()
        self._output = self._plant.advance(self._tick_s, left_1 * u1, left_2 * u2)
