"""Scenarios: every key can be set, nothing else can, and each mistake is one line with its key."""

import dataclasses
import json
import re
import warnings

import pytest
from hypothesis import given, settings, strategies as st
from pydantic import TypeAdapter, ValidationError

from can_rig.errors import ScenarioError
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load, load_values
from can_rig.scenario.plant_settings import BUILT_IN, PlantSettings
from can_rig.scenario.settings import DesignSettings, Scenario, leaves
from firmware_model.design.vehicle import VehicleParameters
from tests.helpers import refuses
from tests.rig.scenario.page_of_keys import keys_of_the_page

ACTUATOR_LIMITS = re.compile(r"actuator\.(limit|rate)_")
ELSEWHERE = re.compile(
    r"name|model|network|controller|plant\.((kind|fmi_type|a|b|c|e)$|g1|g2|gw|input_|output)"
    r"|drive\.(speed_mps|ramps|file)|design\.speeds_mps|reference\.(lane_changes_s|samples_mps2)"
    r"|fault\.other|plant\.sensor\.is_made"
)
"""Keys with tests of their own."""
DEFAULTS = leaves(Scenario("x"))


def another(key: str, allowed: str) -> object:
    """A value that a key may have beside its default, by what the page of keys allows."""
    default, words = DEFAULTS[key], re.findall(r'"([^"]+)"', allowed)
    if words:
        return next(word for word in words if word != default)
    if allowed.startswith("true"):
        return not default
    if allowed.startswith("text"):
        return "words"
    if allowed.startswith("one of"):  # the kinds of faults
        return "frames-missing"
    if allowed.startswith("whole"):
        return default - 1 if default > 1 else default + 1
    return 1.25 * default if default else 0.02


OTHER = {
    key: another(key, allowed)
    for key, allowed in keys_of_the_page()
    if key in DEFAULTS and not ELSEWHERE.match(key)
} | {"design.compensation": "off"}  # which needs no verdict


def test_the_defaults_are_the_thesis_s():
    car = Scenario("x").plant
    assert (car.mass_kg, car.yaw_inertia_kgm2, car.speed_mps) == (1400, 2457, 10)  # Table 3.2
    assert (car.front_cornering_stiffness_n_per_rad, car.trail_m) == (33700, 0.05)
    step = load("thesis-step")
    assert (step.duration_s, step.tick_s, step.ticks, step.tick_ns) == (20, 0.001, 20000, 10**6)
    assert (step.loss.kind, step.loss.channel, step.loss.at_s) == ("actuator-dead", "torque", 10)
    assert load("thesis-sine").reference.frequency_rad_per_s == 5
    assert load("no-compensation").design.compensation == "off"


def test_what_the_shipped_scenarios_say_of_their_bus_and_actuators_holds():
    default, ideal, slow = load("default"), load("ideal").plant, load("slow-bus")
    assert default.plant.torque_actuator.lag_s == default.model.torque_actuator.lag_s > 0.0
    assert None not in (default.limits.torque_nm, default.limits.force_difference_n)
    assert ideal.torque_actuator == ideal.torque_actuator.__class__()
    assert load("slow-bus", ["latency_ticks=from-bus"]).latency_ticks <= slow.latency_ticks
    assert load("highway").plant.speed_mps == load("highway").model.speed_mps


def test_the_page_has_every_key_and_another_value_for_it():
    assert set(OTHER) == {key for key in DEFAULTS if not ELSEWHERE.match(key)}
    assert all(DEFAULTS[key] != value for key, value in OTHER.items())


@pytest.mark.parametrize("key", OTHER)
def test_set_changes_that_key_and_no_other(key, tmp_path):
    (tmp_path / "x.toml").write_text('fault.kind = "none"\nreference.kind = "step"')
    value = OTHER[key]
    after = leaves(load(str(tmp_path / "x.toml"), [f"{key}={json.dumps(value)}"]))
    expected = DEFAULTS | {key: value}
    if key.startswith("plant.") and not ACTUATOR_LIMITS.search(key):
        expected[key.replace("plant", "model")] = value  # the controller knows its car
    assert after == expected


@pytest.mark.parametrize(
    "key", [key for key in OTHER if key.startswith("plant.") and not ACTUATOR_LIMITS.search(key)]
)
def test_the_model_can_differ_from_the_plant(key, tmp_path):
    (tmp_path / "x.toml").write_text("")
    key = key.replace("plant", "model")
    value = OTHER[key.replace("model", "plant")]
    after = leaves(load(str(tmp_path / "x.toml"), [f"{key}={json.dumps(value)}"]))
    assert after == DEFAULTS | {key: value}


def test_later_settings_win_whole_numbers_are_numbers_and_quotes_are_optional():
    scenario = load("thesis-step", ["plant.speed_mps=20", "plant.speed_mps = 30"])
    assert (scenario.plant.speed_mps, type(scenario.plant.speed_mps)) == (30.0, float)
    for text in ("fault.kind=none", "fault.kind='none'", 'fault.kind = "none"'):
        assert load("thesis-step", [text]).loss.kind == "none"


def test_a_scenario_survives_json_and_is_frozen():
    one_lag = {key: value for key, value in OTHER.items() if "natural_frequency" not in key}
    scenario = load("thesis-sine", [f"{k}={json.dumps(v)}" for k, v in one_lag.items()])
    assert load_values("thesis-sine", json.loads(json.dumps(scenario.as_dict()))) == scenario
    with pytest.raises(dataclasses.FrozenInstanceError):
        scenario.tick_s = 1.0


LIMITS = [
    "budget.false_alarms_per_hour=1e300", "budget.suspicions_per_hour=1e300", "budget.box=0.999",
    "budget.actuator_box=0.999", "reference.amplitude_mps2=-1e6", "plant.friction=10",
    "fault.at_s=1e6", "fault.for_s=1e6", "actuator.hold_s=1e6",
]  # fmt: skip


@pytest.mark.parametrize("tick_s", ["1e-5", "0.001"])
def test_the_largest_values_that_are_allowed_make_a_controller_and_a_plant(tick_s):
    scenario = load("default", [*LIMITS, f"tick_s={tick_s}", "duration_s=0.1"])
    controller_table(scenario, network_of(scenario))
    SimulatedPlant(scenario).advance(0, 1.0, 1.0)


FILES = {
    "not TOML": (b"tick_s = = 1\n", "not readable as TOML"),
    "a long number": (b"seed = " + 5001 * b"9", "not readable as TOML: a number must have at most"),
    "not text": (b"\xff\xfe\x00", "not readable as TOML"),
    "a deep list": (b"seed = " + 5001 * b"[", "not readable as TOML: lists must not be so deep"),
    "unknown table": (b"[fualt]\nat_s = 1.0\n", "fualt: unknown key; did you mean fault?"),
    "quotes": (b'"plant.mass_kg" = 9.0', '"plant.mass_kg": must stand without quotation marks'),
    "unknown key": (b"[fault]\nat = 1.0\n", "fault.at: unknown key; did you mean at_s?"),
    "key of a table": (
        b"speed_mps = 20\n",
        "speed_mps: unknown key; did you mean plant.speed_mps?",
    ),
    "text for a number": (b'tick_s = "0.001"\n', "tick_s"),
    "not a number": (b"tick_s = nan\n", "tick_s"),
    "a name": (b'name = "other"\n', "name: unknown key"),
    "an array for a table": (b"[[plant]]\nmass_kg = 1.0\n", "plant"),
}


def test_a_list_too_deep_in_a_setting_is_one_line():
    with refuses("--set seed=[[["):
        load("default", ["seed=" + 5001 * "["])


@pytest.mark.parametrize(("text", "reason"), FILES.values(), ids=FILES.keys())
def test_a_bad_file_is_one_line(text, reason, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_bytes(text)
    with refuses(reason) as caught:
        load(str(path))
    assert str(caught.value).startswith(f"scenario {path}") or "scenario bad" in str(caught.value)


CAR = [field.name for field in dataclasses.fields(VehicleParameters)]
SCHEMA = TypeAdapter(PlantSettings).json_schema()["properties"]


cars = st.fixed_dictionaries(
    {key: st.floats(SCHEMA[key]["minimum"], SCHEMA[key]["maximum"]) for key in CAR}
)


@given(cars)
@settings(deadline=None)
def test_a_car_within_bounds_runs_or_is_refused_in_one_line_without_a_warning(car):
    changes = [f"plant.{key}={value!r}" for key, value in car.items()]
    with warnings.catch_warnings(action="error"):
        try:
            SimulatedPlant(load("thesis-step", changes)).advance(0, 1.0, 1.0)
        except ScenarioError as error:
            assert "\n" not in str(error)
            assert "plant: " in str(error)


@pytest.mark.parametrize(
    "make",
    [lambda: PlantSettings(speed_mps=1e6),
     lambda: dataclasses.replace(PlantSettings(), mass_kg=-1.0), lambda: DesignSettings(tau_s=0.0),
     lambda: Scenario("x", latency_ticks=65),
     lambda: dataclasses.replace(Scenario("x"), tick_s=2.0), lambda: PlantSettings(weight_kg=1.0)],
)  # fmt: skip
def test_a_bound_holds_wherever_settings_are_made(make):
    with pytest.raises(ValidationError):
        make()


def test_what_a_kind_of_plant_is_follows_from_one_table():
    car, example = PlantSettings(), load("chapter-2").plant
    own = PlantSettings(kind="mycar:Car")
    assert (car.is_car, car.is_class) == (True, False)
    assert (example.is_car, example.is_class) == (False, False)
    assert (own.is_car, own.is_class) == (True, True)
    assert {kind.dbc for kind in BUILT_IN.values()} == {"steer_by_wire.dbc", "plant_by_numbers.dbc"}
    assert load("chapter-2").dbc == "plant_by_numbers.dbc"
