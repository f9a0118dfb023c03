"""Step 3 of the search: whether a tuning works with every car of the box, and if not, why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from can_rig.assessment.drives import Drives, Finding
from can_rig.assessment.tuning.box import Car, is_stable
from can_rig.assessment.tuning.refusals import Refusal
from can_rig.scenario.build import continuous_plant, network_of, target
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario
from firmware_model.target.structs import Record

AT_REST = 0.05  # largest error at rest, as a share of the step


def box_refusal(
    scenario: Scenario, table: Record, cars: Sequence[Car], spare_ticks: int
) -> tuple[Refusal, Car | None] | None:
    """The first failed test of ``scenario``'s tuning, and the failing drive's car.

    None: it fails none.

    The tests cover the linear loop with each car, a drive of each car with limits and noise, and a
    drive with the spare ticks.
    """
    if not is_stable(table, cars, scenario.tick_s, spare_ticks):
        stable = is_stable(table, cars, scenario.tick_s, 0)
        return (Refusal.BOX_SPARE if stable else Refusal.BOX), None
    stepped = replace(scenario, reference=replace(scenario.reference, kind="step"))
    if continuous_plant(scenario.model).integrates:
        stepped = scenario  # at rest no command would show the loss
    drives = Drives(stepped, network_of(scenario))
    for car in cars:
        plant = with_sensor_and_limits(car.settings, scenario.plant)
        found = _finding(drives, plant)
        if found is not None and found.false_alarm:
            return Refusal.FALSE_ALARM, car
        if found is not None:
            return _limit_at_fault(stepped, plant), car
        if spare_ticks > 0:
            late = _finding(drives, _late(plant, spare_ticks * scenario.tick_s))
            if late is not None and not late.false_alarm:
                return Refusal.REST_SPARE, car
    return None


def has_control_authority(scenario: Scenario, car: Car) -> bool:
    """Whether X_diff alone can hold the step with ``car``; otherwise no tuning comes to rest."""
    _, force_n = car.steady_commands(scenario.reference.amplitude_mps2)
    return (1.0 - AT_REST) * force_n <= target(scenario, None).limit_2


def with_sensor_and_limits(car: PlantSettings, own: PlantSettings) -> PlantSettings:
    """``car``, which is near the model, with the sensor and the limits of the scenario's plant."""
    torque, force = own.torque_actuator, own.force_difference_actuator
    return replace(
        car,
        sensor=own.sensor,
        torque_actuator=replace(
            car.torque_actuator, limit_nm=torque.limit_nm, rate_nm_per_s=torque.rate_nm_per_s
        ),
        force_difference_actuator=replace(
            car.force_difference_actuator, limit_n=force.limit_n, rate_n_per_s=force.rate_n_per_s
        ),
    )


def _finding(drives: Drives, plant: PlantSettings) -> Finding | None:
    return next(drives.findings("", plant, "torque dead"), None)


def _limit_at_fault(scenario: Scenario, plant: PlantSettings) -> Refusal:
    """The limit that keeps D* of ``plant`` from rest."""
    for refusal, without in (
        (Refusal.FORCE_LIMIT, ("force_difference_n",)),
        (Refusal.TORQUE_LIMIT, ("torque_nm",)),
        (Refusal.BOTH_LIMITS, ("force_difference_n", "torque_nm")),
    ):
        limits = replace(scenario.limits, **dict.fromkeys(without))
        drives = Drives(replace(scenario, limits=limits), network_of(scenario))
        if _finding(drives, plant) is None:
            return refusal
    return Refusal.REST


def _late(plant: PlantSettings, delay_s: float) -> PlantSettings:
    """``plant`` with actuators delayed further by ``delay_s``."""
    torque, force = plant.torque_actuator, plant.force_difference_actuator
    return replace(
        plant,
        torque_actuator=replace(torque, dead_time_s=torque.dead_time_s + delay_s),
        force_difference_actuator=replace(force, dead_time_s=force.dead_time_s + delay_s),
    )
