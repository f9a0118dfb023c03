"""From a scenario to what the firmware and the figures need: plant, design, target, table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Final

from can_rig.errors import ScenarioError
from can_rig.frames.dbc import shipped_dbc
from can_rig.frames.network import Network, load_network
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario
from firmware_model.design import plants
from firmware_model.design.actuator_dynamics import behind
from firmware_model.design.continuous_design import ContinuousDesign, DesignSpecification, design
from firmware_model.design.mismatch import TRUSTED, Mismatch, principal_mismatch
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.errors import DesignError
from firmware_model.target.fault_decision.covariance import MAX_DIRECTIONS
from firmware_model.target.structs import FloatArray, Record

MOST_TABLES: Final = 16
_TABLES: Final[dict[str, Record]] = {}
"""The last ones that were computed, by everything that they follow from."""

GOVERNED = 0.5  # share of the motor's limit that may go into the second derivative of D*


def network_of(scenario: Scenario) -> Network:
    """The scenario's frames, from its DBC."""
    return _network(scenario.dbc)


@cache
def _network(dbc: str) -> Network:
    return load_network(shipped_dbc(dbc))


def continuous_car(settings: PlantSettings) -> plants.Plant:
    """The linear plant that ``settings`` describe, without its actuators and its sensor.

    Of a plant that is a class, all that is known before it runs: the thesis's car with its
    parameters. Designs and margins are of that car, runs are of the class.

    Raises:
        ScenarioError: parameters with which the car is not stable.
    """
    try:
        return settings.linear.make(settings, settings.variant)
    except DesignError as error:
        raise ScenarioError(f"plant: {error}") from None


def continuous_plant(settings: PlantSettings) -> plants.Plant:
    """``continuous_car`` behind its actuators and its sensor, as far as they are linear.

    Raises:
        ScenarioError: as ``continuous_car``.
    """
    return behind(continuous_car(settings), *settings.stages)


def continuous_design(scenario: Scenario) -> ContinuousDesign:
    """The controller's design, for the car that it believes in.

    Raises:
        ScenarioError: an assumption of the thesis that this car or this tuning breaks.
    """
    chosen = scenario.design
    specification = DesignSpecification(
        tau_s=chosen.tau_s,
        alpha=chosen.alpha,
        tau_q_s=chosen.tau_q_s,
        alpha_q=chosen.alpha_q,
        compensation=chosen.compensation != "off",
        feedback=scenario.model.closed_loop,
    )
    plant = continuous_plant(scenario.model)
    _refuse_slow_sensor(scenario)
    try:
        return design(plant, specification)
    except DesignError as error:
        raise ScenarioError(f"scenario {scenario.name}: design: {error}") from None


def _refuse_slow_sensor(scenario: Scenario) -> None:
    """C inverts the sensor's filter too, and must not ask the car for what that filter hides.

    With q̂ faster than the filter, y follows the reference and D* overshoots it, by all that C adds
    above the corner.
    """
    corner_hz, chosen = scenario.model.sensor.corner_hz, scenario.design
    if corner_hz is None or not scenario.model.closed_loop:
        return
    bandwidth = math.sqrt(2.0 ** (1.0 / chosen.alpha_q) - 1.0) / (2.0 * math.pi)
    least_hz = bandwidth / chosen.tau_q_s
    if corner_hz < least_hz:
        table = "plant" if scenario.plant.sensor == scenario.model.sensor else "model"
        raise ScenarioError(
            f"scenario {scenario.name}: {table}.sensor.corner_hz = {corner_hz:g}: must be at least "
            f"{least_hz:.4g} Hz, the bandwidth of q̂, or design.tau_q_s at least "
            f"{bandwidth / corner_hz:.4g}"
        )


def target(scenario: Scenario, network: Network | None) -> Target:
    """Where the design runs, trusting the model; see ``mismatch`` for the cars that are not it.

    Without a network, commands are neither limited nor rounded by it.
    """
    chosen, limits = scenario.design, scenario.limits
    follows = chosen.estimator == "kalman"
    limit_1, limit_2, rate_1, rate_2 = (
        math.inf if limit is None else limit
        for limit in (
            limits.torque_nm,
            limits.force_difference_n,
            limits.torque_rate_nm_per_s,
            limits.force_difference_rate_n_per_s,
        )
    )
    sensor = scenario.model.sensor
    lsb = lsb_1 = lsb_2 = 0.0
    if network is not None:
        command_1, command_2 = network.command_1, network.command_2
        limit_1, limit_2 = min(limit_1, command_1.maximum), min(limit_2, command_2.maximum)
        lsb_1, lsb_2 = command_1.lsb, command_2.lsb
        lsb = network.feedback.lsb
    return Target(
        tick_s=scenario.tick_s,
        latency_ticks=scenario.latency_ticks,
        estimator="zoh" if chosen.estimator == "kalman" else chosen.estimator,
        limit_1=limit_1,
        limit_2=limit_2,
        rate_1=rate_1,
        rate_2=rate_2,
        reference_acceleration=reference_acceleration(scenario),
        lsb_1=lsb_1,
        lsb_2=lsb_2,
        noise_rms=sensor.noise_mps2,
        noise_pole=math.exp(-scenario.tick_s / sensor.lag_s) if sensor.lag_s > 0.0 else 0.0,
        resolution=math.hypot(sensor.resolution_mps2, lsb),
        false_alarms_per_hour=scenario.budget.false_alarms_per_hour,
        suspicions_per_hour=scenario.budget.suspicions_per_hour,
        probe=chosen.probe_nm,
        probe_rad_per_s=chosen.probe_rad_per_s,
        on_confirmation=chosen.compensation == "on-confirmation" or follows,
        share_drift=chosen.share_drift if follows else 0.0,
        precision=chosen.precision,
    )


UNCERTAIN: Final = (
    "mass_kg",
    "front_cornering_stiffness_n_per_rad",
    "rear_cornering_stiffness_n_per_rad",
    "speed_mps",
)
"""Parameters that differ from car to car and from day to day; the rest of Table 3.1 is known."""


def mismatch(scenario: Scenario) -> Mismatch:
    """The cars that are not the model, along the principal directions of the budget's box."""
    model, budget, chosen = scenario.model, scenario.budget, scenario.design
    if not model.is_car:
        return TRUSTED
    keys = UNCERTAIN if budget.box > 0.0 else ()
    late = budget.actuator_box > 0.0 and model.torque_actuator.lags

    def channels(place: FloatArray) -> tuple[ZeroPoleGain, ZeroPoleGain]:
        car = in_box(
            model, {key: budget.box * float(x) for key, x in zip(keys, place, strict=False)}
        )
        if late:
            car = with_lags(car, 1.0 + budget.actuator_box * float(place[-1]))
        plant = continuous_plant(car)
        return plant.g1, plant.g2

    return principal_mismatch(
        channels, len(keys) + late, chosen.tau_q_s * chosen.alpha_q, MAX_DIRECTIONS
    )


def in_box(model: PlantSettings, shares: Mapping[str, float]) -> PlantSettings:
    """``model`` with parameters that are greater by these shares, 0.2 for 20 %."""
    values = {key: getattr(model, key) * (1.0 + share) for key, share in shares.items()}
    return replace(model, **values)


def with_lags(model: PlantSettings, factor: float) -> PlantSettings:
    """``model`` with actuators that are slower by ``factor``."""
    return replace(
        model,
        torque_actuator=model.torque_actuator.slower(factor),
        force_difference_actuator=model.force_difference_actuator.slower(factor),
    )


def reference_acceleration(scenario: Scenario) -> float:
    """How fast a reference C may follow, m/s⁴: what ``GOVERNED`` of the motor's limits can do.

    u1 = r̈/g1 and the rest of D/N1, so half of the limit goes to r̈. A turn from full ahead to full
    back is 2R/g1, smoothed by q̂: at most 0.37·2R/(g1 τ_q) a second for α_q = 2, less for more, and
    as much again is left for the rest.
    """
    limits = scenario.limits
    if not scenario.model.closed_loop:  # no C that would follow
        return math.inf
    torque = math.inf if limits.torque_nm is None else limits.torque_nm
    if limits.torque_rate_nm_per_s is not None:
        torque = min(torque, limits.torque_rate_nm_per_s * scenario.design.tau_q_s)
    return GOVERNED * torque * abs(continuous_car(scenario.model).g1.gain)


def controller_table(scenario: Scenario, network: Network | None) -> Record:
    """The constant table of the scenario's controller on ``network`` (None: without frames).

    Raises:
        ScenarioError: a design that cannot be made or discretised.
    """
    place = target(scenario, network)
    known = repr((place, scenario.model, scenario.design, scenario.budget))
    if known not in _TABLES:
        try:
            place = replace(place, mismatch=mismatch(scenario))
            table = build(continuous_design(scenario), place)
        except DesignError as error:
            raise ScenarioError(f"scenario {scenario.name}: {error}") from None
        if len(_TABLES) == MOST_TABLES:
            del _TABLES[next(iter(_TABLES))]
        _TABLES[known] = table
    return _TABLES[known].copy()
