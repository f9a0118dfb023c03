"""A plant with its actuators and its sensor, a tick at a time.

A linear plant is exact; a plant class advances in steps far shorter than the lags. Both also report
signals beyond the frames, by names that end in a unit.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from can_rig.errors import ScenarioError
from can_rig.logs.columns import APPLIED, SECOND_MASS, TRUE_OUTPUT
from can_rig.plant.actuators import FollowedCommand
from can_rig.plant.disturbances import Disturbances
from can_rig.plant.protocol import GuardedPlant, load_plant
from can_rig.plant.sensor import FilteredSamples
from can_rig.plant.witnesses import PlantRead
from can_rig.scenario.build import but_for_noise, continuous_car, continuous_plant
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.remembered import remembered
from can_rig.scenario.sensor_settings import FurtherSensor
from firmware_model.analysis.sampled_plant import SampledPlant, follow, sample
from firmware_model.analysis.witnesses import (
    ECHO,
    Reading,
    acting_before,
    read_witnesses,
    with_readings,
)
from firmware_model.design.actuator_dynamics import IDEAL, Stage
from firmware_model.design.plants import Plant, push
from firmware_model.design.vehicle import SPECIFIC_FORCE
from firmware_model.law.structs import FloatArray

LONGEST_STEP_S = 5e-4
"""Longest time of a constant command for a plant class whose actuators or sensor lag."""

CAR_STATES = ("side_slip_rad", "yaw_rate_rad_per_s", None, "steering_angle_rad")
"""State names of the linear car, in state order."""


class ActuatedPlant(PlantRead, Protocol):
    """A plant with its actuators and its sensor, initially at rest.

    ``follow`` raises a RigError for an exception in the user's plant class.
    """

    def report(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> Mapping[str, float]:
        """Signals of this tick: the car's state, and the actions that these commands cause."""


Sensors = tuple[FurtherSensor, ...]


def readings_of(sensors: Sensors) -> list[Reading]:
    """What further sensors read of a linear plant."""
    return [Reading(_READS[each.measures], each.lag_s) for each in sensors]


_READS: Final[dict[str, int]] = {
    "yaw-rate": 0,
    "lateral-acceleration": SPECIFIC_FORCE,
    "steering-angle": 2,
    "torque-echo": ECHO,
    "force-difference-echo": ECHO + 1,
}


def with_outputs(plant: Plant, sensors: Sensors) -> Plant:
    """``plant`` with what the further outputs of a plant by numbers read of its states."""
    outputs = {_READS[each.measures]: each.c for each in sensors if each.c is not None}
    if not outputs:
        return plant
    world = plant.world or push(np.zeros(len(plant.a)))
    rows = world.rows.copy()
    for at, row in outputs.items():
        rows[at, : len(row)] = row
    return replace(plant, world=replace(world, rows=rows))


@remembered(16, by=but_for_noise)
def sampled_plant(settings: PlantSettings, tick_s: float, sensors: Sensors = ()) -> SampledPlant:
    """A linear plant with its actuators and its sensors between two ticks.

    Raises:
        ScenarioError: a car that is not stable.
    """
    bare = with_outputs(continuous_plant(settings), sensors)
    plant, readings = with_readings(bare, settings.stages, readings_of(sensors))
    return sample(plant, tick_s, readings)


class ActuatedLinearPlant:
    """The thesis's plants: one matrix for car, actuators and sensor."""

    def __init__(self, settings: PlantSettings, tick_s: float, sensors: Sensors = ()) -> None:
        self.sampled = sampled_plant(settings, tick_s, sensors)
        self.witnesses = np.zeros(len(sensors))
        self._constants, self.memory = self.sampled.constants, self.sampled.memory
        # Compile before the first tick, on a separate memory.
        follow(self._constants, self.sampled.memory, 0, 0.0, 0.0, 1.0, 1.0)
        self._tick = 0
        self.read(0.0, 0.0, 1.0, 1.0)
        self._output = 0.0
        second = settings.second_mass
        beside = () if second is None else (*[None] * second, SECOND_MASS)
        self._names = CAR_STATES if settings.is_car else beside
        at = len(continuous_car(settings).a)
        self._actuators: list[int | None] = []  # index of each lag's output in the state
        for stage in settings.stages[:2]:
            order = len(stage.realisation[0])
            self._actuators.append(at if order else None)
            at += order
        self._ago = [  # ticks between a command and its entry into a lag right after a tick
            dead + bool(late.any())
            for dead, late in zip(self.sampled.dead_ticks, self.sampled.gamma_old.T, strict=True)
        ]

    def report(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> Mapping[str, float]:
        """See ``ActuatedPlant``."""
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
        """The values of ``report`` at these ``ticks`` of a run from rest, (len(ticks),) each.

        Args:
            output: (ticks,), D* of the car.
            states: (ticks, n), of the sampled plant.
            reached: (2, ticks), the commands at the actuators' inputs.
            left: (ticks, 2), the share of each command that a fault left.
            ticks: consecutive ticks.
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
                first = max(begin, ago)  # the first command arrives here
                sent[first - begin :] = reached[channel, first - ago : max(end, first) - ago]
                applied = left[begin:end, channel] * (sent + 0.0)  # a frame carries no -0.0
            columns[APPLIED[channel]] = applied
        return columns

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``ActuatedPlant``."""
        output, read = follow(
            self._constants, self.memory, self._tick, command_1, command_2, left_1, left_2
        )
        self.read(command_1, command_2, left_1, left_2)
        self.moved(output)
        return output, read

    def acted(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """What acted on the inputs just before the tick to which ``memory`` has advanced."""
        return (
            acting_before(self._constants, self.memory, self._tick, command_1, left_1, 0),
            acting_before(self._constants, self.memory, self._tick, command_2, left_2, 1),
        )

    def read(self, command_1: float, command_2: float, left_1: float, left_2: float) -> None:
        """Read the further sensors at the tick to which ``memory`` has advanced.

        The commands, and what faults left of them, are those of the tick before.
        """
        if len(self.witnesses):
            acted = self.acted(command_1, command_2, left_1, left_2)
            readings = self.sampled.readings.constants
            read_witnesses(readings, self.memory[0], *acted, self.witnesses)

    def moved(self, output: float) -> None:
        """Record a tick that advanced ``memory``; ``output`` is D* of the car."""
        self._tick += 1
        self._output = output


class ActuatedClassPlant:
    """A plant class in equal steps of a tick, each with the mean of the actuators' output.

    With immediate actuators and an immediate sensor, one step spans the whole tick.

    Raises:
        ScenarioError: a class that violates ``PlantProtocol``.
    """

    def __init__(
        self,
        settings: PlantSettings,
        tick_s: float,
        sensors: Sensors = (),
        world: Disturbances | None = None,
    ) -> None:
        plant = load_plant(settings.kind, settings)
        self._world, self._tick, self._speed_mps = world, 0, settings.speed_mps
        self._plant = GuardedPlant(settings.kind, plant)
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
        self.witnesses = np.zeros(len(sensors))
        self._sources = [each.source for each in sensors]
        self._filters = [FilteredSamples(Stage(each.lag_s), tick_s) for each in sensors]
        self._channels = [_READS[each.measures] - ECHO for each in sensors]
        self._plant.advance(self._step_s, 0.0, 0.0)  # compile before the first tick
        self._plant.reset()
        if sensors:
            self._require(settings.kind)

    def report(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> Mapping[str, float]:
        """See ``ActuatedPlant``."""
        return {
            TRUE_OUTPUT: self._output,
            **self._plant.signals(),
            APPLIED[0]: self._actuators[0].output(command_1, left_1),
            APPLIED[1]: self._actuators[1].output(command_2, left_2),
            **({} if self._world is None else self._world.report(self._tick)),
        }

    def push(self, world: Disturbances) -> None:
        """From this tick on, another world."""
        assert self._world is not None
        self._world = world

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``ActuatedPlant``."""
        world = self._next_world()
        if self._ideal:
            acting = left_1 * command_1, left_2 * command_2
            self._output = self._plant.advance(self._step_s, *acting, *world[:1])
            self._read(acting)
            return self._output, self._output
        read = 0.0
        means_1 = self._actuators[0].follow(command_1, left_1)
        means_2 = self._actuators[1].follow(command_2, left_2)
        for step, (torque_nm, force_n) in enumerate(zip(means_1, means_2, strict=True)):
            around = world[step : step + 1]
            self._output = self._plant.advance(self._step_s, torque_nm, force_n, *around)
            read = self._sensor.next(self._output)
        self._read((self._actuators[0].acted, self._actuators[1].acted))
        return self._output, read

    def _require(self, kind: str) -> None:
        """Refuse a plant that does not report what a further sensor reads."""
        reported = self._plant.readable()
        for source in self._sources:
            if source and source not in reported:
                raise ScenarioError(
                    f"sensor: plant.kind = {kind!r}: signals() must report {source}, or "
                    f"sensor.signal name another; reported: {', '.join(reported) or 'nothing'}"
                )

    def _read(self, acted: tuple[float, float]) -> None:
        """Read the further sensors; straight lines connect the ticks for their filters."""
        if not self._sources:
            return
        reported = self._plant.readable()
        for at, (source, filtered) in enumerate(zip(self._sources, self._filters, strict=True)):
            truth = reported[source] if source else acted[self._channels[at]]
            self.witnesses[at] = filtered.next(truth)

    def _next_world(self) -> list[FloatArray]:
        """The world around each step of this tick; empty in a calm world."""
        if self._world is None:
            return []
        now, then = self._world.during(self._tick)
        self._tick += 1
        if self._world.is_calm:
            return []
        parts = np.arange(self._steps + 1)[:, None] / self._steps
        rows = np.hstack([now + parts * (then - now), np.full_like(parts, self._speed_mps)])
        return [rows[step : step + 2] for step in range(self._steps)]
