"""Runs share computations, and every run equals the same run computed alone."""

import dataclasses
import math
import random
import shlex
from typing import Any

import numpy as np
import pytest
import tomli_w
from numpy.lib.recfunctions import structured_to_unstructured

from can_rig.campaigns.plan import plan
from can_rig.campaigns.rows import Task, run_rows
from can_rig.campaigns.settings import campaign_of, read_campaign
from can_rig.plant.frameless import frameless
from can_rig.results.counterfactual import loop_of, signals_without_log
from can_rig.results.metrics import metrics_of
from can_rig.scenario import shipped
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load

MIXED: dict[str, Any] = {
    "settings": {"duration_s": 0.2, "fault.at_s": 0.1, "fault.value": 3.0},
    "axes": {"fault.kind": {"values": ["none", "actuator-dead", "actuator-stuck", "sensor-biased",
                                       "frames-missing"]},
             "reference.amplitude_mps2": {"values": [0.5, 1.0]},
             "plant.sensor.noise_mps2": {"values": [0.0, 1e-3]},
             "plant.mass_kg": {"values": [1250.0, 1300.0]}},
    "runs": 24,
}  # fmt: skip


def test_a_run_is_the_same_after_whatever_others():
    made = plan(campaign_of("mixed", MIXED))
    together = run_rows(made, Task(0, made.runs))
    order = random.Random(1).sample(range(made.runs), made.runs)
    one_by_one = {run: run_rows(made, Task(run, run + 1))[0] for run in order}
    assert [one_by_one[run] for run in range(made.runs)] == together


def test_the_loop_of_a_run_is_the_one_that_is_made_for_it_alone():
    made = plan(campaign_of("mixed", MIXED))
    for run in range(made.runs):
        scenario = made.scenario_of(run)
        found, alone = signals_without_log(scenario), frameless(scenario)
        np.testing.assert_array_equal(found.dstar_mps2, alone.measured)
        np.testing.assert_array_equal(found.reference_mps2, alone.reference)


def test_a_file_that_has_changed_is_read_again(tmp_path):
    file, other = tmp_path / "r.csv", tmp_path / "other.csv"
    settings = [
        "duration_s=0.2", "fault.at_s=0.1", "fault.kind=actuator-dead", "reference.kind=csv",
    ]  # fmt: skip
    file.write_text("0,1\n1,1\n")
    scenario = load("default", [*settings, f"reference.file={file}"])
    before = metrics_of(scenario)
    for path in (file, other):
        path.write_text("0,1\n1,2.5\n")
    after = metrics_of(scenario)
    assert after == metrics_of(load("default", [*settings, f"reference.file={other}"]))
    assert after["deviation_peak_after_fault_mps2"] != before["deviation_peak_after_fault_mps2"]
    assert loop_of(scenario.healthy).inputs[0][-1] > 1.1


NUMBERS = [
    "plant={kind='state-space', a=[[-1.0]], b=[[1.0, 2.0]], c=[1.0]}",
    "model.a=[[-1.1]]", "design.alpha=1", "design.alpha_q=1",
]  # fmt: skip
AXES: list[tuple[str, list[str], dict[str, list[Any]], bool]] = [
    ("default", [], {"plant.mass_kg": [1300.0], "plant.variant": ["published"]}, True),
    ("default", ["model.mass_kg=1500"], {"plant.mass_kg": [1300], "model.speed_mps": [11]}, True),
    ("default", [], {"plant.torque_actuator.lag_s": [0.01], "plant.friction": [0.5]}, False),
    ("default", ["model.torque_actuator.natural_frequency_rad_per_s=200"],
     {"plant.torque_actuator.lag_s": [0.01], "plant.torque_actuator.limit_nm": [50.0]}, True),
    ("slow-bus", ["latency_ticks=from-bus"], {"bus.compute_s": [1e-4, 8e-4]}, False),
    ("default", [], {"latency_ticks": ["from-bus", 3]}, False),
    ("default", ["latency_ticks=from-bus"], {"latency_ticks": [3]}, False),
    ("lane-change", ["fault.1.kind=sensor-dead"],
     {"fault.1.at_s": [1], "fault.0.left": [0.5], "fault.0.kind": ["actuator-dead"]}, False),
    ("default", [], {"fault.1.kind": ["sensor-stuck", "none"], "fault.0.at_s": [2.0],
                     "fault.0.kind": ["actuator-dead"]}, False),
    ("default", [], {"plant.kind": ["steer-by-wire", "some.module:Car"],
                     "plant.sensor.corner_hz": [400.0]}, True),
    ("ideal", ["plant={kind='a:B', parameters={body={mass=1}}}"],
     {"plant.parameters.body.mass": [2, True], "plant.parameters.more": [1.0]}, False),
    ("default", NUMBERS, {"plant.kind": ["a:B"], "plant.parameters.x": ["text"]}, False),
    ("chapter-2", [], {"plant.g1.gain": [2.0, 3]}, True),
    ("chapter-2", ["model.g1={num=[1, 3.1], den=[1, 3, 2]}"], {"plant.g1.gain": [2.0]}, True),
    ("default", [], {"seed": [7], "reference.kind": ["sine"], "tick_s": [0.002]}, False),
]  # fmt: skip


@pytest.mark.parametrize(("name", "settings", "axes", "redesign"), AXES)
def test_the_command_of_a_run_has_the_scenario_of_the_run(name, settings, axes, redesign, tmp_path):
    """Settings objects with an axis's value are those that ``--set`` makes of the file."""
    campaign = {
        "scenario": name, "sampling": "grid", "redesign": redesign,
        "axes": {key: {"values": values} for key, values in axes.items()},
    }  # fmt: skip
    (tmp_path / "some.toml").write_text(tomli_w.dumps(campaign))
    made = plan(read_campaign(str(tmp_path / "some.toml"), settings))
    for run in range(made.runs):
        words = shlex.split(made.base.command_with(made.changes_of(run)))
        again = load(words[2], [word for word in words if "=" in word])
        assert made.scenario_of(run) == again
        assert repr(made.scenario_of(run)) == repr(again)  # 1 and 1.0 are equal


def test_settings_are_hashable_and_every_digit_counts():
    scenario, again = load("default"), load("default")
    assert (scenario, hash(scenario)) == (again, hash(again))
    plant = dataclasses.replace(
        scenario.plant, mass_kg=math.nextafter(scenario.plant.mass_kg, math.inf)
    )
    assert dataclasses.replace(scenario, plant=plant) != scenario
    kinds = [load("ideal", ["plant.kind=a:B", f"plant.parameters.x={x}"]) for x in ("1", "true")]
    assert hash(kinds[0]) != hash(kinds[1])
    assert all(hash(load(name)) for name in shipped())


@pytest.mark.parametrize(
    ("setting", "same"),
    [("budget.box=0.1", False), ("design.tau_q_s=0.02", False), ("model.mass_kg=1500", False),
     ("model.torque_actuator.lag_s=0.01", False), ("limits.torque_nm=5", False),
     ("latency_ticks=2", False), ("seed=3", True), ("fault={kind='none', at_s=2}", True),
     ("reference.amplitude_mps2=2", True)],
)  # fmt: skip
def test_a_table_follows_from_every_setting_of_the_controller(setting, same):
    usual, other = (load("default", settings) for settings in ((), (setting,)))
    tables = [
        structured_to_unstructured(controller_table(each, network_of(each)))
        for each in (usual, other)
    ]
    assert np.array_equal(*tables, equal_nan=True) == same
