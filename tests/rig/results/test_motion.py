"""The path of a car, against circles and the deviation of a lost motor."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from can_rig.logs.columns import APPLIED, SECOND_MASS
from can_rig.panel.live import SecondMass
from can_rig.results.motion import scene, track_of, tracks
from can_rig.results.signals import Signals, signals_of_columns
from can_rig.scenario.loading import load
from can_rig.scenario.plant_settings import SignalSettings
from can_rig.scenario.settings import Scenario
from tests.helpers import on_no_bus

SPEED_MPS = 10.0


def signals_with(**plant: np.ndarray) -> Signals:
    ticks = len(next(iter(plant.values())))
    columns = [np.zeros(ticks)] * 7
    return Signals(0.001 * np.arange(ticks), *columns, plant=plant)


def recorded(tmp_path, name: str, *settings: str) -> tuple[Scenario, Signals]:
    scenario = load(name, list(settings))
    log = tmp_path / "bus.log"
    columns = on_no_bus(scenario, log).columns
    return scenario, signals_of_columns(columns, scenario.tick_s, log)


def test_a_constant_yaw_rate_is_a_circle_and_a_side_slip_turns_the_course():
    turning = np.full(5001, 0.2)
    slip = np.full(5001, 0.03)
    moving = signals_with(yaw_rate_rad_per_s=turning, side_slip_rad=slip)
    x_m, y_m, heading = track_of(load("ideal"), moving)
    assert heading[-1] == pytest.approx(1.0)
    radius_m = SPEED_MPS / 0.2
    centre = -radius_m * np.sin(0.03), radius_m * np.cos(0.03)
    distance = np.hypot(x_m - centre[0], y_m - centre[1])
    np.testing.assert_allclose(distance, radius_m, atol=1e-4)
    assert np.arctan2(y_m[1], x_m[1]) == pytest.approx(0.03, abs=2e-4)


def test_a_reported_speed_replaces_the_speed_of_the_scenario():
    still = {name: np.zeros(1001) for name in ("yaw_rate_rad_per_s", "side_slip_rad")}
    moving = signals_with(**still, speed_mps=np.linspace(0.0, 20.0, 1001))
    assert track_of(load("ideal"), moving).x_m[-1] == pytest.approx(10.0)


def test_a_thinned_track_is_the_whole_track_thinned_and_needs_no_copy_of_the_run():
    rng = np.random.default_rng(5)
    names = "yaw_rate_rad_per_s", "side_slip_rad", "speed_mps"
    moving = signals_with(**{name: rng.normal(size=100_001) for name in names})
    whole = track_of(load("ideal"), moving)
    tracemalloc.start()
    thinned = track_of(load("ideal"), moving, step=20)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    for values, some in zip(whole, thinned, strict=True):
        np.testing.assert_array_equal(some, values[::20])
    assert peak < 3 * moving.time_s.nbytes  # BLOCK_ROWS of some columns at once


def test_the_car_stays_in_its_lane_and_leaves_the_lane_without_compensation(tmp_path):
    driven, lane, without = tracks(*recorded(tmp_path, "lane-change"))
    off_m, off_without_m = (
        float(np.hypot(track.x_m - lane.x_m, track.y_m - lane.y_m).max())
        for track in (driven, without)
    )
    assert off_m < 0.3
    assert off_without_m > 1.75  # half a lane
    assert lane.y_m[8000] == pytest.approx(3.5, abs=0.1)  # between both lane changes


def test_before_the_fault_all_tracks_are_one(tmp_path):
    settings = "plant.sensor.noise_mps2=0", "fault.at_s=0.8", "duration_s=1"
    driven, lane, without = tracks(*recorded(tmp_path, "ideal", *settings))
    for track in (lane, without):
        np.testing.assert_allclose(track.y_m[:800], driven.y_m[:800], atol=1e-9)
    assert abs(without.y_m[-1] - driven.y_m[-1]) > 1e-3


def test_a_run_without_a_fault_has_no_other_car(tmp_path):
    found = tracks(*recorded(tmp_path, "ideal", "fault.kind=none", "duration_s=0.2"))
    assert found.without is None
    assert found.lane is not None


@pytest.mark.parametrize(
    ("name", "kind"), [("pendulum", "angle"), ("two-masses", "position"), ("satellite", "angle")]
)
def test_another_plant_is_drawn_by_its_output(tmp_path, name, kind):
    scenario, signals = recorded(tmp_path, name, "duration_s=1", "fault.at_s=0.5")
    drawn = scene(scenario, signals)
    assert drawn["kind"] == kind
    step = round(0.02 / scenario.tick_s)
    np.testing.assert_array_equal(drawn["columns"]["output"], signals.dstar_mps2[::step])
    assert [each["begin"] for each in drawn["dead"]] == [0.5]


@pytest.mark.parametrize(("name", "feedback"), [("nonminimum-phase", True), ("chapter-2", False)])
def test_any_other_plant_is_drawn_as_blocks(tmp_path, name, feedback):
    drawn = scene(*recorded(tmp_path, name, "duration_s=0.2"))
    assert (drawn["kind"], drawn["feedback"]) == ("blocks", feedback)


def test_a_second_mass_is_where_the_applied_forces_push_it(tmp_path):
    scenario, signals = recorded(tmp_path, "two-masses", "duration_s=4", "fault.at_s=2")
    plant, forces = scenario.plant, np.stack([signals.plant[name] for name in APPLIED], axis=1)
    state, positions = np.zeros(4), []
    for pushed in forces:
        positions.append(state[1])
        rates = lambda _t, x, pushed=pushed: np.array(plant.a) @ x + np.array(plant.b) @ pushed  # noqa: E731
        state = solve_ivp(rates, (0.0, scenario.tick_s), state, rtol=1e-9, atol=1e-12).y[:, -1]
    assert positions[-1] > 1.0  # force 2 alone holds the first mass
    np.testing.assert_allclose(signals.plant[SECOND_MASS], positions, atol=1e-8)
    np.testing.assert_array_equal(
        scene(scenario, signals)["columns"]["x"], signals.plant[SECOND_MASS][::2]
    )
    live = SecondMass(scenario)
    np.testing.assert_allclose([live.next(each) for each in forces], positions, atol=1e-8)


@pytest.mark.parametrize(
    "other",
    [
        {"c": (0.0, 1.0, 0.0, 0.0)},  # the first mass is then the second
        {"c": (1.0, 1.0, 0.0, 0.0)},
        {"b": ((0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 0.5))},
        {"output": SignalSettings("position", "mm")},
    ],
)
def test_without_two_states_that_are_positions_no_second_mass_is_drawn(other):
    plant = load("two-masses").plant
    assert plant.second_mass == 1
    assert replace(plant, **other).second_mass == (0 if other.get("c", (1,))[0] == 0.0 else None)
