"""The linear car of a scenario with a drive: its speed follows the drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from can_rig.logs.columns import SPEED
from can_rig.plant.behind import LinearBehind, PlantBehind, plant_behind, sampled_plant
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.driving import speed_profile, speeds_at_ticks
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.changing_plant import ChangingPlant, changing_plant, follow_changing
from firmware_model.analysis.sampled_plant import SampledPlant


def plant_of(scenario: Scenario) -> PlantBehind:
    """Make the plant of ``scenario``, at rest, behind its actuators and its sensor.

    Raises:
        ScenarioError: an unstable car, a class without the plant's methods, an invalid drive.
    """
    if scenario.drive.is_given:
        return ChangingCar(scenario)
    return plant_behind(scenario.plant, scenario.tick_s)


def linear_plant(scenario: Scenario) -> SampledPlant | None:
    """The linear plant from tick to tick; None for a plant class and for a drive.

    Raises:
        ScenarioError: a car that is not stable.
    """
    if scenario.plant.is_own or scenario.drive.is_given:
        return None
    return sampled_plant(scenario.plant, scenario.tick_s)


@remembered(4)
def _changing(settings: PlantSettings, fastest_mps: float, tick_s: float) -> ChangingPlant:
    return changing_plant(
        lambda speed: continuous_plant(replace(settings, speed_mps=speed)), fastest_mps, tick_s
    )


class ChangingCar:
    """``LinearBehind`` with a changing speed; see ``PlantBehind``."""

    def __init__(self, scenario: Scenario) -> None:
        profile = speed_profile(scenario)
        _, fastest = profile.range_mps
        changing = _changing(scenario.plant, fastest, scenario.tick_s)
        self._car = LinearBehind(scenario.plant, scenario.tick_s)
        self._constants, self._work = changing.constants, changing.work
        self._within = changing.speeds(profile, scenario.ticks)
        self._at_ticks = speeds_at_ticks(scenario).tolist()
        self._tick = 0
        spare = (self._car.sampled.memory, changing.work, self._within)
        follow_changing(self._constants, *spare, 0, 0.0, 0.0, 1.0, 1.0)  # compiles

    def report(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> Mapping[str, float]:
        """See ``PlantBehind``."""
        of_the_car = self._car.report(command_1, command_2, left_1, left_2)
        return {**of_the_car, SPEED: self._at_ticks[self._tick]}

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``PlantBehind``."""
        output, read = follow_changing(
            self._constants,
            self._car.memory,
            self._work,
            self._within,
            self._tick,
            command_1,
            command_2,
            left_1,
            left_2,
        )
        self._tick += 1
        self._car.moved(output)
        return output, read
