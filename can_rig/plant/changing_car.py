"""The car of a scenario with a drive or with disturbances: speed and world change around it."""

from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np

from can_rig.logs.columns import SPEED
from can_rig.plant.actuated_plant import (
    ActuatedClassPlant,
    ActuatedLinearPlant,
    ActuatedPlant,
    Sensors,
    readings_of,
    sampled_plant,
    with_outputs,
)
from can_rig.plant.disturbances import BANK, BLOCK, Disturbances
from can_rig.plant.protocol import is_pushable, require_world
from can_rig.plant.witnesses import all_samples_arrive
from can_rig.scenario.build import continuous_car
from can_rig.scenario.driving import SpeedProfile, speed_profile
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.changing_plant import (
    NO_WORLD,
    ChangingPlant,
    changing_plant,
    follow_changing,
    pushed_plant,
    read_changing,
    specific_force,
)
from firmware_model.analysis.sampled_plant import SampledPlant
from firmware_model.design.vehicle import GRAVITY_MPS2
from firmware_model.law.structs import FloatArray

ACCELERATIONS: Final = ("specific_force_mps2", "lateral_acceleration_mps2")
"""Columns that a car in the world reports."""


def plant_of(scenario: Scenario, changing: bool = False) -> ActuatedPlant:
    """Make the plant of ``scenario``, at rest, with its actuators and its sensor.

    Args:
        scenario: the run.
        changing: whether the world may begin to push during the run.

    Raises:
        ScenarioError: an unstable car, a class without the plant's methods, an invalid drive, a
            plant that the disturbances cannot push.
    """
    made = Disturbances(scenario)
    if scenario.disturbances:
        require_world(scenario.plant, scenario.disturbances)
    pushes = not made.is_calm or (changing and is_pushable(scenario.plant))
    world = made if pushes else None
    if scenario.drive.is_given or (world is not None and not scenario.plant.is_own):
        return ChangingCar(scenario, world)
    if scenario.plant.is_own:
        return ActuatedClassPlant(scenario.plant, scenario.tick_s, scenario.sensors, world)
    return ActuatedLinearPlant(scenario.plant, scenario.tick_s, scenario.sensors)


def linear_plant(scenario: Scenario) -> SampledPlant | None:
    """The linear plant from tick to tick; None for a plant class, a drive and disturbances.

    None with further sensors for a controller that is not ours, or with a fault of their frames.

    Raises:
        ScenarioError: a car that is not stable.
    """
    if scenario.plant.is_own or scenario.drive.is_given or scenario.disturbances:
        return None
    if scenario.sensors and not scenario.controller.is_ours:
        return None
    if scenario.heard and not all_samples_arrive(scenario):
        return None
    return sampled_plant(scenario.plant, scenario.tick_s, scenario.sensors)


@remembered(4)
def _changing(
    settings: PlantSettings, fastest_mps: float, tick_s: float, sensors: Sensors
) -> ChangingPlant:
    readings = readings_of(sensors)
    if not settings.is_car:
        pushed = with_outputs(continuous_car(settings), sensors)
        return pushed_plant(pushed, settings.stages, tick_s, readings)
    return changing_plant(
        settings, settings.variant, settings.stages, fastest_mps, tick_s, readings
    )


class ChangingCar:
    """A linear plant whose speed changes, or that the world pushes; see ``ActuatedPlant``.

    In a calm world, at one speed, the plant moves as ``ActuatedLinearPlant`` does, bit for bit.
    """

    def __init__(self, scenario: Scenario, world: Disturbances | None = None) -> None:
        profile = (
            speed_profile(scenario)
            if scenario.drive.is_given
            else SpeedProfile(np.zeros(1), np.array([scenario.plant.speed_mps]))
        )
        _, fastest = profile.range_mps
        changing = _changing(scenario.plant, fastest, scenario.tick_s, scenario.sensors)
        self._car = ActuatedLinearPlant(scenario.plant, scenario.tick_s, scenario.sensors)
        self.witnesses, self._acting = self._car.witnesses, changing.acting
        self._world, self._says_speed = world, scenario.drive.is_given
        self._is_car = scenario.plant.is_car
        self._constants, self._work = changing.constants, changing.work
        self._changing, self._profile, self._tick_s = changing, profile, scenario.tick_ns * 1e-9
        self._tick, self._page_at, self._page = 0, -1, np.zeros((0, 0, 0))
        spare = (self._car.sampled.memory, changing.work, self._within(0))
        follow_changing(self._constants, *spare, 0, 0.0, 0.0, 1.0, 1.0, NO_WORLD)  # compiles
        specific_force(self._constants, self._car.memory[0], fastest, NO_WORLD)
        self._read(0.0, 0.0, 1.0, 1.0)

    def report(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> Mapping[str, float]:
        """See ``ActuatedPlant``."""
        values = dict(self._car.report(command_1, command_2, left_1, left_2))
        speed_mps = self._profile(np.array(self._tick * self._tick_s)).item()
        if self._says_speed:
            values[SPEED] = speed_mps
        if self._world is None:
            return values
        values |= self._world.report(self._tick)
        if not self._is_car:
            return values
        now = self._world.during(self._tick)
        force = float(specific_force(self._constants, self._car.memory[0], speed_mps, now))
        gravity = GRAVITY_MPS2 * float(now[0, BANK])  # which no accelerometer reads
        accelerations = (force, force + gravity)
        return values | dict(zip(ACCELERATIONS, accelerations, strict=True))

    def push(self, world: Disturbances) -> None:
        """From this tick on, another world."""
        self._world = world

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``ActuatedPlant``."""
        if self._world is not None and self._world.is_calm and not self._says_speed:
            self._tick += 1
            return self._car.follow(command_1, command_2, left_1, left_2)
        output, read = follow_changing(
            self._constants,
            self._car.memory,
            self._work,
            self._within(self._tick),
            self._tick,
            command_1,
            command_2,
            left_1,
            left_2,
            NO_WORLD if self._world is None else self._world.during(self._tick),
        )
        self._tick += 1
        self._read(command_1, command_2, left_1, left_2)
        self._car.moved(output)
        return output, read

    def _read(self, command_1: float, command_2: float, left_1: float, left_2: float) -> None:
        """Read the further sensors at this tick; the commands are those of the tick before."""
        if len(self.witnesses):
            acted = self._car.acted(command_1, command_2, left_1, left_2)
            speed_mps = self._profile(np.array(self._tick * self._tick_s)).item()
            world = NO_WORLD if self._world is None else self._world.during(self._tick)
            read_changing(
                self._constants, self._car.memory[0], speed_mps, world, self._acting, *acted,
                self.witnesses,
            )  # fmt: skip

    def _within(self, tick: int) -> FloatArray:
        """``ChangingPlant.speeds`` of a tick, computed in pages, however long the run is."""
        first = tick - tick % BLOCK
        if first != self._page_at:
            self._page = self._changing.speeds(self._profile, range(first, first + BLOCK))
            self._page_at = first
        within: FloatArray = self._page[tick - first]
        return within

    def run_loop(
        self,
        loop: Callable[..., tuple[float, float]],
        begin: int,
        end: int,
        output: tuple[float, float],
    ) -> tuple[float, float]:
        """See ``simulation.LoopPlant``."""
        ahead = self._tick - begin
        for some in _pages(self._tick, end + ahead):
            world = NO_WORLD
            if self._world is not None:
                world = self._world.at(range(some.start, some.stop + 1))
            output = loop(
                some.start - ahead, some.stop - ahead, *output, self._constants,
                self._car.memory, ahead, world, self._work,
                self._changing.speeds(self._profile, some),
            )  # fmt: skip
        self._tick = end + ahead
        return output


def _pages(begin: int, end: int) -> Iterator[range]:
    """The ticks from ``begin`` to ``end`` in parts, so that a long run needs little memory."""
    while begin < end:
        stop = min(begin - begin % BLOCK + BLOCK, end)
        yield range(begin, stop)
        begin = stop
