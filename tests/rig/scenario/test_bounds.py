"""The bounds of the settings: each is one line with key, value and bound, and holds everywhere."""

import dataclasses
import warnings
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from can_rig.assessment.resolve import load
from can_rig.errors import ScenarioError
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.plant_settings import BUILT_IN, PlantSettings
from can_rig.scenario.settings import DesignSettings, Scenario
from firmware_model.design.vehicle import VehicleParameters

CAR = [field.name for field in dataclasses.fields(VehicleParameters)]
SCHEMA = TypeAdapter(PlantSettings).json_schema()["properties"]


@pytest.mark.parametrize("key", CAR)
def test_every_parameter_of_the_car_has_two_bounds_around_its_default(key: str) -> None:
    low, high = SCHEMA[key]["minimum"], SCHEMA[key]["maximum"]
    assert low <= getattr(VehicleParameters(), key) <= high
    for beyond in (low - 1.0, low - 1e-9 * max(low, 1e-3), high * (1 + 1e-9), 1e300, -1e300):
        for table in ("plant", "model"):
            with pytest.raises(ScenarioError, match=rf": {table}\.{key} = .*: must be at "):
                load("thesis-step", [f"{table}.{key}={beyond!r}"])


cars = st.fixed_dictionaries(
    {key: st.floats(SCHEMA[key]["minimum"], SCHEMA[key]["maximum"]) for key in CAR}
)


@given(cars)
@settings(deadline=None)
def test_a_car_within_bounds_runs_or_is_refused_in_one_line_without_a_warning(
    car: dict[str, float],
) -> None:
    changes = [f"plant.{key}={value!r}" for key, value in car.items()]
    with warnings.catch_warnings(action="error"):
        try:
            SimulatedPlant(load("thesis-step", changes)).advance(0, 1.0, 1.0)
        except ScenarioError as error:
            assert "\n" not in str(error)
            assert "plant: " in str(error)


@pytest.mark.parametrize(
    "make",
    [
        lambda: PlantSettings(speed_mps=1e6),
        lambda: dataclasses.replace(PlantSettings(), mass_kg=-1.0),
        lambda: DesignSettings(tau_s=0.0),
        lambda: Scenario("x", latency_ticks=65),
        lambda: dataclasses.replace(Scenario("x"), tick_s=2.0),
        lambda: PlantSettings(weight_kg=1.0),
    ],
)
def test_a_bound_holds_wherever_settings_are_made(make: Any) -> None:
    with pytest.raises(ValidationError):
        make()


def test_what_a_kind_of_plant_is_follows_from_one_table() -> None:
    car, example = PlantSettings(), load("chapter-2").plant
    own = PlantSettings(kind="mycar:Car")
    assert (car.is_car, car.is_class) == (True, False)
    assert (example.is_car, example.is_class) == (False, False)
    assert (own.is_car, own.is_class) == (True, True)
    assert {kind.dbc for kind in BUILT_IN.values()} == {"steer_by_wire.dbc", "plant_by_numbers.dbc"}
    assert load("chapter-2").dbc == "plant_by_numbers.dbc"
