"""The simulated car of a run: its actuators, late by the bus's latency, the plant, its sensor."""

from collections import deque
from collections.abc import Mapping

import numpy as np

from can_rig.frames.network import Network
from can_rig.plant.actuated_plant import ActuatedClassPlant
from can_rig.plant.actuators import Actuator, actuator_limits
from can_rig.plant.changing_car import ChangingCar, plant_of
from can_rig.plant.disturbances import Disturbances
from can_rig.plant.faults.plant_faults import FaultsByTick
from can_rig.plant.sensor import NoiseColumns
from can_rig.plant.witnesses import Said, SensesByTick
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.hardware import LATE, SENSOR, distorted, limited, sensor_reading
from firmware_model.law.structs import FloatArray


class SimulatedPlant:
    """The car: two actuators, a latency line, a plant with held commands, a noisy sensor.

    Args:
        scenario: the run.
        changing: whether ``change_faults`` may be called.
        network: the frames of the further sensors; None: nobody hears them.

    Raises:
        ScenarioError: see ``plant_of``.
    """

    def __init__(
        self, scenario: Scenario, changing: bool = False, network: Network | None = None
    ) -> None:
        hold_ticks = round(scenario.actuator.hold_s / scenario.tick_s)
        self._plant = plant_of(scenario, changing)
        self._pushed_by = scenario.disturbance
        self._tick = 0
        self._read = 0.0  # at rest
        self._faults = FaultsByTick(scenario, changing)
        self._actuators = (Actuator(hold_ticks), Actuator(hold_ticks))
        self._latency_ticks = scenario.latency_ticks
        at_once = 1 + self._faults.latest_ticks
        # Earliest arrival of a command or a reading; before, the line holds rest values.
        commands = self._latency_ticks + at_once
        self._on_the_way = deque([(0.0, 0.0)] * commands, commands)
        self._readings = deque([0.0] * at_once, at_once)
        limits = actuator_limits(scenario.plant, scenario.tick_s)
        self._limits = limits.tolist()
        self._is_limited = bool(np.isfinite(limits).any())
        self._reached = (0.0, 0.0)
        self.applied = (0.0, 0.0)
        """The applied commands of both actuators in the last tick."""
        self.reported: Mapping[str, float] = {}
        """The signals of the last tick beyond the frames."""
        self._said = 0.0
        self._noise = NoiseColumns.of(scenario)
        self._senses = None
        if network is not None and network.witnesses:
            self._senses = SensesByTick(scenario, network.witnesses, self._faults)
        self._told = (0.0, 0.0)  # the commands that came to the actuators in the last tick
        self.said: list[Said] = []
        """What the further sensors say at the tick of ``measure``."""
        self._resolution = scenario.plant.sensor.resolution_mps2
        # Compile before the first tick.
        sensor_reading(0.0, 0.0, 0.0, self._resolution)
        limited(0.0, 0.0, *self._limits[0])

    def change_faults(self, scenario: Scenario) -> None:
        """Take the faults and the disturbances of ``scenario`` from this tick on.

        The measurement of this tick is still to come.
        """
        self._faults.change(scenario)
        if scenario.disturbance != self._pushed_by:
            assert isinstance(self._plant, ChangingCar | ActuatedClassPlant)
            self._pushed_by = scenario.disturbance
            self._plant.push(Disturbances(scenario))

    def measure(self) -> float:
        """The sensor's present reading of D*, m/s²."""
        if self._senses is not None:
            self.said = self._senses.take(self._tick, self._plant.witnesses, self._told)
        now = self._faults.at(self._tick)
        (noise,) = self._noise.next(1).tolist()
        reading = float(sensor_reading(self._read, now.bias, noise, self._resolution))
        if now.rows is None:
            return reading
        fault = now.rows[SENSOR]
        self._readings.append(reading)
        late = self._readings[-1 - int(fault[LATE])]
        self._said = float(distorted(late, self._said, fault))
        return self._said

    def advance(
        self, tick: int, command_1: float | None, command_2: float | None
    ) -> Mapping[str, float]:
        """Advance one tick with the valid commands of ``tick`` (None: no valid command).

        Returns:
            Return the signals of ``tick`` beyond the frames.

        Raises:
            RigError: an exception in the user's plant class.
        """
        now = self._faults.at(tick)
        self._tick = tick + 1
        self._on_the_way.append(
            (self._actuators[0].hear(command_1), self._actuators[1].hear(command_2))
        )
        reached_1, reached_2 = self._told = self._on_the_way[-1 - self._latency_ticks]
        if now.rows is not None:
            reached_1, reached_2 = (self._faulty(channel, now.rows[channel]) for channel in (0, 1))
        if self._is_limited:
            reached_1 = float(limited(reached_1, self._reached[0], *self._limits[0]))
            reached_2 = float(limited(reached_2, self._reached[1], *self._limits[1]))
        self._reached = reached_1, reached_2
        self.applied = reached_1 * now.left[0], reached_2 * now.left[1]
        self.reported = self._plant.report(reached_1, reached_2, *now.left)
        _, self._read = self._plant.follow(reached_1, reached_2, *now.left)
        return self.reported

    def _faulty(self, channel: int, fault: FloatArray) -> float:
        late = self._on_the_way[-1 - self._latency_ticks - int(fault[LATE])][channel]
        return float(distorted(late, self._reached[channel], fault))
