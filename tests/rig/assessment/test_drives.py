"""Drives with limits, noise and other cars: findings against runs and by hand."""

import os
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from can_rig.assessment.drives import Drives, Finding, box_cars, box_findings, own_findings
from can_rig.assessment.stability import check_stability, refuse_unstable
from can_rig.errors import ScenarioError
from can_rig.plant.frameless import frameless
from can_rig.scenario.box import CAR as UNCERTAIN
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Simulation
from firmware_model.design import plants
from firmware_model.design.vehicle import Variant, VehicleParameters
from firmware_model.law.status import FaultState
from tests.rig.plant.failing import FAILING

SWINGING = ("limits.torque_rate_nm_per_s=5000", "plant.sensor.noise_mps2=0.005")
OTHER_CAR = {  # a small car; some 40 % off the thesis's
    "mass_kg": 1093.3,
    "yaw_inertia_kgm2": 1791.6,
    "front_axle_distance_m": 1.1562,
    "rear_axle_distance_m": 1.4227,
    "front_cornering_stiffness_n_per_rad": 64850.0,
    "rear_cornering_stiffness_n_per_rad": 52700.0,
}


def findings_of(scenario: Scenario) -> list[Finding]:
    return own_findings(Drives(scenario))


def with_other_car() -> Scenario:
    scenario = load("highway")
    return replace(scenario, model=scenario.plant, plant=replace(scenario.plant, **OTHER_CAR))


def test_a_loop_that_swings_in_its_limits_is_found_though_it_is_stable():
    scenario = load("ideal", SWINGING)
    result = check_stability(scenario)
    assert result.linear_stable
    assert not result.stable
    assert str(result.findings[0]).startswith("this car: healthy: D* is away")
    assert result.verdict.startswith(f"not calm: {result.findings[0]} (and ")
    assert result.verdict.endswith(" more)")
    with pytest.raises(ScenarioError, match=r"not calm: this car: healthy: .*--allow-unstable"):
        refuse_unstable(scenario)
    healthy = frameless(scenario).measurement[5000:9000]
    assert np.ptp(healthy) > 1.0  # m/s², where 1 m/s² is asked for and the noise is 0.005


@pytest.mark.parametrize(
    ("name", "settings"),
    [("ideal", ()), ("ideal", SWINGING[:1]), ("noisy", SWINGING), ("default", SWINGING),
     ("no-compensation", ()), ("chapter-2", ())],
)  # fmt: skip
def test_a_calm_loop_is_calm(name, settings):
    scenario = load(name, settings)
    assert findings_of(scenario) == []
    refuse_unstable(scenario)


def test_a_drive_does_not_end_before_what_is_away_could_return():
    """Satellites that lose their sweep after the loss: runs of 120 s end 1.4 and 4.7 rad away."""
    scenario = load("satellite", ["budget.box=0.3"])
    found = box_findings(Drives(scenario))
    assert found
    assert all("dead" in each.text and "is away" in each.text for each in found)


def test_a_car_outside_the_box_is_named_for_its_false_alarm():
    scenario = with_other_car()
    (found,) = findings_of(scenario)
    assert (found.car, found.false_alarm) == ("this car", True)
    states = frameless(scenario).fault_state[:10_000]
    confirmed = np.flatnonzero(states == FaultState.CONFIRMED)
    assert str(found) == f"this car: false alarm after {confirmed[0] * 1e-3:.3g} s"
    refuse_unstable(scenario)  # a run with it is of use: it shows the false alarm


def test_the_label_of_another_car_is_in_what_is_said_of_it():
    scenario = with_other_car()
    drives = Drives(scenario)
    assert [found.car for found in drives.findings("small", scenario.plant, "torque dead")] == [
        "small"
    ]
    assert list(drives.findings("own", scenario.model, "torque dead")) == []


def test_a_demand_beyond_the_authority_is_no_finding():
    """2989 N hold 1 m/s² without the torque."""
    weak = load("ideal", ["limits.force_difference_n=2900"])
    assert findings_of(weak) == []
    trace = frameless(weak)
    assert abs(trace.error[-1]) > 0.02  # a lasting error beyond the actuator's limit
    assert check_stability(weak).stable


def test_the_cars_of_the_box_are_its_vertices_and_some_from_its_inside():
    scenario = load("default")
    some = list(box_cars(scenario))
    assert len(some) == 2**5 + 8  # four parameters and the lags
    assert len({label for label, _ in some}) == len(some)
    for place, (label, car) in enumerate(some):
        for key in UNCERTAIN:
            share = getattr(car, key) / getattr(scenario.plant, key) - 1.0
            assert abs(share) <= 0.2 + 1e-12
            assert (abs(share) == pytest.approx(0.2)) == (place < 32)
            assert f"{key} {share:+.0%}" in label
        lag = car.torque_actuator.lag_s / scenario.plant.torque_actuator.lag_s
        assert 0.7 - 1e-12 <= lag <= 1.3 + 1e-12
        assert car.sensor == scenario.plant.sensor
    assert list(box_cars(load("thesis-step"))) == []  # no box, nothing that lags


def test_every_car_of_the_box_is_driven_and_said_to_be():
    told: list[tuple[int, int]] = []
    scenario = load("ideal")
    assert box_findings(Drives(scenario), lambda done, of: told.append((done, of))) == []
    assert told == [(done, 24) for done in range(1, 25)]
    trusting = load("ideal", ["budget.box=0"])
    assert box_findings(Drives(trusting)) == []
    found = box_findings(Drives(with_other_car()))
    assert found
    assert all(finding.car.startswith("mass_kg") for finding in found)


def test_every_car_of_the_box_is_made_once(monkeypatch):
    scenario, made, make = load("default", ("plant.mass_kg=1590",)), [], plants.steer_by_wire

    def counted(parameters: VehicleParameters, variant: Variant) -> plants.Plant:
        made.append(parameters)
        return make(parameters, variant)

    monkeypatch.setattr(plants, "steer_by_wire", counted)
    box_findings(Drives(scenario))
    cars = [car for _, car in box_cars(scenario)]
    assert len(cars) == 40
    assert [made.count(car) for car in cars] == [1] * len(cars)


def test_the_traces_of_few_cars_are_kept_at_once(monkeypatch):
    """With a tick of 10 us all 40 traces took 3.6 GB."""
    kept, most = 0, 0

    class Counted(Drives):
        def at_start(self, *car: Any) -> Simulation:
            nonlocal kept, most
            kept += 1
            most = max(most, kept)
            return super().at_start(*car)

        def judged(self, *drive: Any) -> Iterator[Finding]:
            nonlocal kept
            kept -= 1
            return super().judged(*drive)

    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    scenario = load("default")
    box_findings(Counted(scenario))
    assert (kept, most) == (0, 3)


def test_a_plant_that_fails_is_not_merely_away():
    scenario = load("ideal", [FAILING, "plant.parameters.calls=899"])
    drives = Drives(scenario)
    *_, finding = drives.findings("this car", scenario.plant, "torque dead")
    said = re.fullmatch(r"this car: healthy: .*failing:Failing fails at (\S+) s", str(finding))
    assert said
    assert float(said[1]) == pytest.approx(0.9, abs=0.01)


PUSHED = (
    "tick_s=0.01", "design.alpha=2", "design.tau_s=0.05", "design.alpha_q=2", "design.tau_q_s=0.1",
    "plant={kind='state-space', a=[[-1, 0.5], [0, -2]], "
    "b=[[1, 0.5], [0.5, 1]], c=[1, 0], e=[1, 0]}",
    "disturbance={kind='push', at_s=1.0, size=0.1}",
)  # fmt: skip


@pytest.mark.parametrize("model", ["{}", "{a=[[-1]], b=[[1, 0.5]], c=[1]}"])
def test_a_push_on_a_plant_by_numbers_is_checked_with_model_and_tuned_plants(model):
    """The settings of a model say no push, and a model of another order cannot have the plant's."""
    scenario = load("thesis-step", [*PUSHED, f"model={model}"])
    drives = Drives(scenario)
    for plant in (scenario.plant, scenario.model):
        assert list(drives.findings("", plant, "torque dead")) == []
