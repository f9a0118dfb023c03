"""A drive as a scenario has it: what is refused, the speed over time, the driver."""

import numpy as np
import pytest

from can_rig.assessment.tuning.search import tune
from can_rig.errors import ScenarioError
from can_rig.scenario.build import network_of, target
from can_rig.scenario.controls import controller_table, controls
from can_rig.scenario.driving import (
    RATIO,
    at_speed_of,
    design_speeds,
    frozen,
    speed_profile,
    speeds_at_ticks,
)
from can_rig.scenario.loading import load
from can_rig.scenario.reference import reference
from firmware_model.design.vehicle import LOW_SPEED_MPS

RAMP = "drive.ramps=[[1, 10], [3, 16]]"


def test_straight_lines_between_pairs_whose_ends_are_held():
    scenario = load("default", [RAMP, "duration_s=4", "tick_s=0.5", "latency_ticks=1"])
    assert speeds_at_ticks(scenario).tolist() == [10, 10, 10, 11.5, 13, 14.5, 16, 16]
    profile = speed_profile(scenario)
    assert profile.range_mps == (10.0, 16.0)
    assert profile.fastest_change_mps2 == 3.0


def test_a_change_that_is_too_fast_is_refused():
    with pytest.raises(ScenarioError, match=r"by 3 m/s²: must be at most .* = 2$"):
        speed_profile(load("default", [RAMP, "drive.speed_rate_max_mps2=2"]))
    braking = ["drive.ramps=[[1, 16], [3, 10]]", "drive.speed_rate_max_mps2=2"]
    with pytest.raises(ScenarioError, match=r"by 3 m/s²: must be at most .* = 2$"):
        speed_profile(load("default", braking))


def test_a_drive_from_a_file(tmp_path):
    (tmp_path / "v.csv").write_text("time_s,speed_mps\n1,10\n3,16\n")
    (tmp_path / "mine.toml").write_text('[drive]\nfile = "v.csv"\n')
    profile = speed_profile(load(str(tmp_path / "mine.toml")))
    assert profile(np.array([0.0, 2.0, 9.0])).tolist() == [10.0, 13.0, 16.0]
    (tmp_path / "v.csv").write_text("1,10\n3,101\n")
    with pytest.raises(ScenarioError, match="line 2: speed_mps = 101: must be 0 to 100"):
        speed_profile(load(str(tmp_path / "mine.toml")))


def test_designs_are_near_enough_to_each_other_and_reach_both_ends():
    speeds = design_speeds(load("drive-cycle"))
    assert speeds[0] == pytest.approx(8.0) and speeds[-1] == pytest.approx(30.0)
    assert (np.diff(np.log(speeds)) <= np.log(RATIO) * (1 + 1e-9)).all()
    assert len(design_speeds(load("default", ["drive.ramps=[[0, 1], [60, 100]]"]))) == 16
    assert design_speeds(load("default", ["drive.ramps=[[0, 0], [9, 9]]"]))[0] == LOW_SPEED_MPS
    assert len(design_speeds(load("default", ["drive.speed_mps=0"]))) == 2  # hears the speed
    assert design_speeds(load("default", [RAMP, "design.speeds_mps=[11]"])) == (11.0,)


def test_one_speed_has_the_table_of_a_scenario_without_a_drive():
    scenario = load("default", ["drive.speed_mps=14"])
    of = controls(scenario, network_of(scenario))
    alone = load("default", ["plant.speed_mps=14"])
    assert of.schedule is None
    assert str(of.table) == str(controller_table(alone, network_of(alone)))
    assert frozen(scenario, 14.0).plant == alone.plant


def test_figures_of_one_speed_are_those_where_the_fault_begins():
    scenario = load("default", [RAMP, "fault.at_s=2"])
    assert at_speed_of(scenario, scenario.loss).plant.speed_mps == 13.0
    assert at_speed_of(scenario, scenario.loss).model.speed_mps == 13.0
    still = load("default")
    assert at_speed_of(still, still.loss) is still


def test_a_tuning_is_for_one_speed():
    with pytest.raises(ScenarioError, match=r"drive: must not be given, for a tuning is for one"):
        tune(load("default", [RAMP]), [])


def test_the_driver_goes_to_the_other_lane_and_back():
    settings = ["reference.kind=driver", "reference.lane_changes_s=[4, 14]", "duration_s=25"]
    scenario = load("default", [*settings, "reference.amplitude_mps2=1.5"])
    r = reference(scenario)
    assert np.abs(r).max() <= 1.5
    assert (r[: round(2.0 / scenario.tick_s)] == 0.0).all()  # nobody reacts before seeing it
    offset = np.cumsum(np.cumsum(r)) * scenario.tick_s**2
    assert offset[12_000] == pytest.approx(3.5, abs=0.02)
    assert offset[-1] == pytest.approx(0.0, abs=0.02)
    assert offset.max() < 3.5 * 1.06
    assert np.abs(np.diff(r)).max() < 2.0 * 1.5 / 0.2 * scenario.tick_s


def test_the_witness_doubts_a_speed_that_no_frame_measures():
    doubts = []
    for drive in ([], ["drive.speed_mps=20"]):
        scenario = load("cluster", drive)
        witness = target(scenario, network_of(scenario)).witness
        assert witness is not None
        doubts.append(witness.doubt)
    assert doubts == [0.2, 0.0]
