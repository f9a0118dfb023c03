"""What runs of a campaign have in common is computed once, and none of them shows it."""

from __future__ import annotations

import dataclasses
import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from can_rig.assessment.resolve import load
from can_rig.campaigns.plan import plan
from can_rig.campaigns.run import Task, run_rows
from can_rig.campaigns.settings import campaign_of
from can_rig.plant.frameless import frameless
from can_rig.results.counterfactual import loop_of, signals_without_log
from can_rig.results.metrics import metrics_of
from can_rig.scenario.build import network_of
from can_rig.scenario.catalogue import shipped
from can_rig.scenario.remembered import text_of
from can_rig.scenario.settings import Scenario

SHORT = ["duration_s=0.2", "fault.at_s=0.1"]
MIXED: dict[str, Any] = {
    "settings": {"duration_s": 0.2, "fault.at_s": 0.1, "fault.value": 3.0},
    "axes": {
        "fault.kind": {
            "values": ["none", "actuator-dead", "actuator-stuck", "sensor-biased", "frames-missing"]
        },
        "reference.amplitude_mps2": {"values": [0.5, 1.0]},
        "plant.sensor.noise_mps2": {"values": [0.0, 1e-3]},
        "plant.mass_kg": {"values": [1250.0, 1300.0]},
    },
    "runs": 24,
}


def test_a_run_is_the_same_after_whatever_others() -> None:
    made = plan(campaign_of("mixed", MIXED))
    together = run_rows(made, Task(0, made.runs))
    order = random.Random(1).sample(range(made.runs), made.runs)
    one_by_one = {run: run_rows(made, Task(run, run + 1))[0] for run in order}
    assert [one_by_one[run] for run in range(made.runs)] == together


def test_the_loop_of_a_run_is_the_one_that_is_made_for_it_alone() -> None:
    made = plan(campaign_of("mixed", MIXED))
    for run in range(made.runs):
        scenario = made.scenario_of(run)
        found, alone = signals_without_log(scenario), frameless(scenario, network_of(scenario))
        np.testing.assert_array_equal(found.dstar_mps2, alone.measured)
        np.testing.assert_array_equal(found.reference_mps2, alone.reference)


def test_a_file_that_has_changed_is_read_again(tmp_path: Path) -> None:
    file, other = tmp_path / "r.csv", tmp_path / "other.csv"
    settings = [
        "duration_s=0.2",
        "fault.at_s=0.1",
        "fault.kind=actuator-dead",
        "reference.kind=csv",
    ]
    file.write_text("0,1\n1,1\n")
    scenario = load("default", [*settings, f"reference.file={file}"])
    before = metrics_of(scenario)
    for path in (file, other):
        path.write_text("0,1\n1,2.5\n")
    after = metrics_of(scenario)
    assert after == metrics_of(load("default", [*settings, f"reference.file={other}"]))
    assert after["deviation_peak_after_fault_mps2"] != before["deviation_peak_after_fault_mps2"]
    assert loop_of(scenario.healthy).inputs[0][-1] > 1.1


@pytest.mark.parametrize("name", shipped())
def test_tables_that_are_read_one_by_one_make_the_scenario(name: str) -> None:
    """As the whole of it, read at once; and what two scenarios have in common is one table."""
    one, other = (load(name, [f"seed={seed}"]) for seed in (1, 2))
    values = {**one.as_dict(), "fault": [dataclasses.asdict(each) for each in one.fault]}
    assert TypeAdapter(Scenario).validate_python(values, strict=False) == one
    if name == "default":  # whose file has one
        assert one.plant is other.plant


def test_a_text_has_every_digit() -> None:
    """Of a scenario that was not asked for before, with tables that were."""
    scenario = load("default")
    plant = dataclasses.replace(
        scenario.plant, mass_kg=math.nextafter(scenario.plant.mass_kg, math.inf)
    )
    heavier = dataclasses.replace(scenario, plant=plant)
    assert text_of(heavier) != text_of(scenario)
    assert text_of(dataclasses.replace(heavier, plant=scenario.plant)) == text_of(scenario)
