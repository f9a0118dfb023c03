"""The tables of a scenario's controller: one design, or a design for each speed of its drive."""

from dataclasses import replace

from can_rig.errors import ScenarioError
from can_rig.frames.network import Network
from can_rig.scenario.build import continuous_design, other_plants, target, uncertain_keys
from can_rig.scenario.driving import design_speeds, frozen
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from firmware_model.design.mismatch import Mismatch, principal_mismatch
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.schedules import AtSpeed, Scheduled, schedule
from firmware_model.discretisation.tables import build
from firmware_model.errors import DesignError
from firmware_model.law.layout import Table
from firmware_model.law.structs import FloatArray
from firmware_model.law.supervision.covariance import MAX_DIRECTIONS

MOST_TABLES = 16  # limit of the cache


def controller_table(scenario: Scenario, network: Network | None) -> Table:
    """The constant table of the scenario's controller on ``network`` (None: without frames).

    Raises:
        ScenarioError: a failing design or discretisation.
    """
    return _table(scenario, network).copy()


def sources_of_table(scenario: Scenario, network: Network | None) -> tuple[object, ...]:
    """Every setting of the controller's table; faults, noise and references have no influence."""
    return target(scenario, network), scenario.model, scenario.design, scenario.budget


@remembered(MOST_TABLES, by=sources_of_table)
def _table(scenario: Scenario, network: Network | None) -> Table:
    try:
        place = replace(target(scenario, network), mismatch=mismatch(scenario))
        return build(continuous_design(scenario), place)
    except DesignError as error:
        raise ScenarioError(f"scenario {scenario.name}: {error}") from None


def mismatch(scenario: Scenario) -> Mismatch:
    """The plants beside the model, along the principal directions of the budget's box."""
    chosen = scenario.design
    keys, late = uncertain_keys(scenario)
    other = other_plants(scenario)

    def channels(place: FloatArray) -> tuple[ZeroPoleGain, ZeroPoleGain]:
        plant = other(place)
        return plant.g1, plant.g2

    return principal_mismatch(
        channels, len(keys) + late, chosen.tau_q_s, chosen.alpha_q, MAX_DIRECTIONS
    )


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
