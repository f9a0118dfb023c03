"""Actuators and sensor of plant and model: derived values, and refusals in a line."""

import math

import pytest

from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_design, continuous_plant
from can_rig.scenario.loading import load, load_run
from can_rig.scenario.settings import Scenario

ORDERS = ["design.alpha=3", "design.alpha_q=4", "design.tau_s=0.01", "design.tau_q_s=0.02"]


def test_the_model_knows_the_lags_of_the_plant_and_not_its_limits():
    scenario = load("default", [*ORDERS, "plant.torque_actuator.lag_s=0.005",
        "plant.torque_actuator.limit_nm=50", "plant.torque_actuator.rate_nm_per_s=5000",
        "plant.sensor.corner_hz=50", "plant.sensor.noise_mps2=0.01"])  # fmt: skip
    assert scenario.model.torque_actuator.lag_s == 0.005
    assert scenario.model.torque_actuator.limits == (math.inf, math.inf)
    assert scenario.model.sensor == scenario.plant.sensor
    assert continuous_design(scenario).plant.g1.relative_degree == 4


def test_one_key_of_the_model_leaves_its_others_to_the_plant():
    own = ["plant.torque_actuator.lag_s=0.005", "plant.torque_actuator.dead_time_s=0.002"]
    scenario = load("default", [*own, "model.torque_actuator.lag_s=0"])
    believed = scenario.model.torque_actuator
    assert (believed.lag_s, believed.dead_time_s) == (0.0, 0.002)


@pytest.mark.parametrize(
    ("plant", "model"),
    [
        ("lag_s=0.005", "natural_frequency_rad_per_s=200"),
        ("natural_frequency_rad_per_s=200", "lag_s=0.005"),
        ("natural_frequency_rad_per_s=200", "lag_s=0"),
    ],
)
def test_another_lag_of_the_model_takes_the_place_of_the_plant_s(plant, model):
    given = [f"plant.torque_actuator.{plant}", f"model.torque_actuator.{model}"]
    scenario = load("ideal", given)
    key, value = model.split("=")
    assert getattr(scenario.model.torque_actuator, key) == float(value)
    again = load_run(scenario.as_dict())
    assert again == scenario
    assert continuous_plant(again.model).g1.relative_degree == 2 + (
        0 if value == "0" else 1 if key == "lag_s" else 2
    )


def test_what_a_run_believed_as_it_was_follows_the_plant_in_another_run():
    given = ["plant.torque_actuator.lag_s=0.005", "plant.torque_actuator.dead_time_s=0.002"]
    values = load("default", [*given, "model.torque_actuator.lag_s=0.004"]).as_dict()
    again = load_run(
        values, ["plant.torque_actuator.dead_time_s=0.003", "plant.sensor.corner_hz=90"]
    )
    believed = again.model.torque_actuator
    assert (believed.lag_s, believed.dead_time_s) == (0.004, 0.003)
    assert again.model.sensor.corner_hz == 90


def test_orders_that_the_lags_make_too_small_are_named_with_the_least():
    with pytest.raises(ScenarioError, match=r"alpha_q = 2: .* must be at least 3"):
        continuous_design(
            load("default", ["plant.torque_actuator.lag_s=0.005", "design.alpha_q=2"])
        )


@pytest.mark.parametrize(
    ("key", "table"), [("plant.sensor.corner_hz", "plant"), ("model.sensor.corner_hz", "model")]
)
def test_a_sensor_slower_than_the_tracking_is_refused(key, table):
    """The bandwidth of 1/(1 + τs)⁴ with τ = 20 ms is 3.46 Hz, by its definition."""
    slow = load("default", [*ORDERS, f"{key}=3"])
    with pytest.raises(ScenarioError) as refused:
        continuous_design(slow)
    line = str(refused.value)
    assert f"{table}.sensor.corner_hz = 3: must be at least 3.461 Hz" in line
    assert "or design.tau_q_s at least 0.02308" in line
    at_the_edge = 0.43498 / (2 * math.pi * 0.02)
    assert abs(1 / (1 + 1j * 0.43498) ** 4) == pytest.approx(math.sqrt(0.5), rel=1e-4)
    continuous_design(load("default", [*ORDERS, f"{key}={at_the_edge + 0.001}"]))


def test_ideal_is_the_default():
    assert Scenario("any").plant.stages == Scenario("any").model.stages
    assert all(stage.dead_time_s == stage.lag_s == 0.0 for stage in Scenario("any").plant.stages)
