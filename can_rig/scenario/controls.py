"""The tables of a scenario's controller: one design, or a design for each speed of its drive."""

from __future__ import annotations

from dataclasses import replace

from can_rig.errors import ScenarioError
from can_rig.frames.network import Network
from can_rig.scenario.build import (
    continuous_design,
    controller_table,
    mismatch,
    other_plants,
    sources_of_table,
    target,
)
from can_rig.scenario.driving import design_speeds, frozen
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from firmware_model.design.mismatch import Mismatch
from firmware_model.discretisation.schedules import AtSpeed, Scheduled, schedule
from firmware_model.errors import DesignError


def controls(scenario: Scenario, network: Network | None) -> Scheduled:
    """The controller of ``scenario`` on ``network`` (None: without frames).

    Raises:
        ScenarioError: a failing design or discretisation, an invalid drive.
    """
    if not scenario.drive.is_given:
        return Scheduled(None, controller_table(scenario, network))
    speeds = design_speeds(scenario)
    if len(speeds) == 1:
        return Scheduled(None, controller_table(frozen(scenario, speeds[0]), network))
    several = replace(scenario, design=replace(scenario.design, speeds_mps=speeds))
    return _scheduled(several, network)


@remembered(4, by=sources_of_table)
def _scheduled(scenario: Scenario, network: Network | None) -> Scheduled:
    speeds = scenario.design.speeds_mps or ()
    middle = mismatch(frozen(scenario, speeds[len(speeds) // 2]))
    try:
        return schedule([_at(frozen(scenario, speed), network, middle) for speed in speeds])
    except DesignError as error:
        raise ScenarioError(f"scenario {scenario.name}: design.speeds_mps: {error}") from None


def _at(scenario: Scenario, network: Network | None, middle: Mismatch) -> AtSpeed:
    """The design for one speed; the directions of other cars are common to all speeds."""
    others = tuple(other_plants(scenario)(place) for place in middle.places)
    cars = Mismatch(tuple((plant.g1, plant.g2) for plant in others))
    return AtSpeed(
        speed_mps=scenario.model.speed_mps,
        design=continuous_design(scenario),
        target=replace(target(scenario, network), mismatch=cars),
        others=others,
    )
