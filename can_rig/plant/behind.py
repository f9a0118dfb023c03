"""A plant behind its actuators and its sensor, a tick at a time.

A linear one is exact; any other goes in steps that are short beside the lags. Either also reports
signals that no frame carries, by a name that ends in their unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from can_rig.logs.columns import APPLIED, TRUE_OUTPUT
from can_rig.plant.actuators import FollowedCommand
from can_rig.plant.protocol import GuardedPlant, load_plant
from can_rig.plant.sensor import FilteredSamples
from can_rig.scenario.build import but_for_noise, continuous_car, continuous_plant
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.remembered import remembered
from firmware_model.analysis.sampled_plant import SampledPlant, follow, sample
from firmware_model.design.actuator_dynamics import IDEAL
from firmware_model.target.structs import FloatArray

LONGEST_STEP_S = 5e-4
"""Over which the car of a class gets a constant command, where its actuators or sensor lag."""

CAR_STATES = ("side_slip_rad", "yaw_rate_rad_per_s", None, "steering_angle_rad")
"""Of the linear car, in the order of its state."""


class PlantBehind(Protocol):
    """A plant behind its actuators and its sensor, at rest when it is made."""

    def report(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> Mapping[str, float]:
        """Signals of this tick: the car's, and what acts on it from these commands on."""

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """One tick on: D* of the car, and what the sensor reads; see ``simulation.AnyPlant``.

        Raises:
            RigError: an exception in a plant that is the user's own.
        """


def plant_behind(settings: PlantSettings, tick_s: float) -> PlantBehind:
    """The plant that ``settings`` name, at rest, behind its actuators and its sensor.

    Raises:
        ScenarioError: a car that is not stable, a class that is no plant.
    """
    if settings.is_own:
        return ClassBehind(settings, tick_s)
    return LinearBehind(settings, tick_s)


@remembered(16, by=but_for_noise)
def sampled_plant(settings: PlantSettings, tick_s: float) -> SampledPlant:
    """A linear plant behind its actuators and its sensor between two ticks.

    Raises:
        ScenarioError: a car that is not stable.
    """
    return sample(continuous_plant(settings), tick_s)


class LinearBehind:
    """The plants of the thesis: one matrix for car, actuators and sensor."""

    def __init__(self, settings: PlantSettings, tick_s: float) -> None:
        self.sampled = sampled_plant(settings, tick_s)
        self._constants, self.memory = self.sampled.constants, self.sampled.memory
        # Compiles before the first tick needs it, on a memory of its own.
        follow(self._constants, self.sampled.memory, 0, 0.0, 0.0, 1.0, 1.0)
        self._tick = 0
        self._output = 0.0
        self._names = CAR_STATES if settings.is_car else ()
        at = len(continuous_car(settings).a)
        self._actuators: list[int | None] = []  # where the output of each lag is in the state
        for stage in settings.stages[:2]:
            order = len(stage.realisation[0])
            self._actuators.append(at if order else None)
            at += order
        self._ago = [  # ticks before which the command came that enters a lag right after a tick
            dead + bool(late.any())
            for dead, late in zip(self.sampled.dead_ticks, self.sampled.gamma_old.T, strict=True)
        ]

    def report(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> Mapping[str, float]:
        """See ``PlantBehind``."""
        commands = self.memory[2]
        x = self.memory[0].tolist()
        values = {TRUE_OUTPUT: self._output}
        for name, state in zip(self._names, x, strict=False):
            if name:
                values[name] = state
        given = ((command_1, left_1), (command_2, left_2))
        for channel, (command, left) in enumerate(given):
            at, ago = self._actuators[channel], self._ago[channel]
            if at is not None:
                applied = x[at]
            elif ago == 0:
                applied = left * command
            else:
                applied = left * float(commands[(self._tick - ago) % len(commands), channel])
            values[APPLIED[channel]] = applied
        return values

    def report_columns(
        self,
        output: FloatArray,
        states: FloatArray,
        reached: FloatArray,
        left: FloatArray,
        ticks: range,
    ) -> dict[str, FloatArray]:
        """What ``report`` says of these ``ticks`` of a run from rest, (len(ticks),) each.

        Args:
            output: (ticks,), D* of the car.
            states: (ticks, n), of the sampled plant.
            reached: (2, ticks), the commands that reached the actuators.
            left: (ticks, 2), what a fault left of them.
            ticks: which of them; one behind the other.
        """
        begin, end = ticks.start, ticks.stop
        columns = {TRUE_OUTPUT: output[begin:end]}
        for at, name in enumerate(self._names):
            if name:
                columns[name] = states[begin:end, at]
        for channel, (place, ago) in enumerate(zip(self._actuators, self._ago, strict=True)):
            if place is not None:
                applied = states[begin:end, place]
            else:
                sent = np.zeros(len(ticks))
                first = max(begin, ago)  # from here on a command has come
                sent[first - begin :] = reached[channel, first - ago : max(end, first) - ago]
                applied = left[begin:end, channel] * (sent + 0.0)  # a frame has no -0.0
            columns[APPLIED[channel]] = applied
        return columns

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``PlantBehind``."""
        output, read = follow(
            self._constants, self.memory, self._tick, command_1, command_2, left_1, left_2
        )
        self.moved(output)
        return output, read

    def moved(self, output: float) -> None:
        """A tick has passed, in which ``memory`` was advanced; D* of the car is ``output``."""
        self._tick += 1
        self._output = output


class ClassBehind:
    """A plant of one's own, in equal steps of a tick, each with the mean of what the actuators do.

    Behind immediate actuators and sensor one step is the whole tick.
    """

    def __init__(self, settings: PlantSettings, tick_s: float) -> None:
        self._plant = GuardedPlant(settings.kind, load_plant(settings.kind, settings))
        actuator_1, actuator_2, sensor = settings.stages
        ideal = actuator_1 == actuator_2 == sensor == IDEAL
        self._steps = 1 if ideal else math.ceil(tick_s / LONGEST_STEP_S - 1e-9)
        self._step_s = tick_s / self._steps
        self._actuators = [
            FollowedCommand(stage, tick_s, self._steps) for stage in (actuator_1, actuator_2)
        ]
        self._ideal = ideal
        self._sensor = FilteredSamples(sensor, self._step_s)
        self._output = 0.0
        self._plant.advance(self._step_s, 0.0, 0.0)  # compiles before the first tick needs it
        self._plant.reset()

    def report(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> Mapping[str, float]:
        """See ``PlantBehind``."""
        return {
            TRUE_OUTPUT: self._output,
            **self._plant.signals(),
            APPLIED[0]: self._actuators[0].output(command_1, left_1),
            APPLIED[1]: self._actuators[1].output(command_2, left_2),
        }

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``PlantBehind``."""
        if self._ideal:
            self._output = self._plant.advance(self._step_s, left_1 * command_1, left_2 * command_2)
            return self._output, self._output
        read = 0.0
        means_1 = self._actuators[0].follow(command_1, left_1)
        means_2 = self._actuators[1].follow(command_2, left_2)
        for torque_nm, force_n in zip(means_1, means_2, strict=True):
            self._output = self._plant.advance(self._step_s, torque_nm, force_n)
            read = self._sensor.next(self._output)
        return self._output, read
