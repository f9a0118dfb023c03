"""Metrics of each fault: by hand, and beside the run without it."""

from __future__ import annotations

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.results.counterfactual import output_of_car, signals_without_log
from can_rig.results.metrics import fault_metrics, fault_rows, metrics
from tests.rig.results.quiet import quiet

BOTH = ["duration_s=6", "fault.at_s=2", "fault.for_s=1.5", "fault.1.kind=sensor-stuck"]
BOTH += ["fault.1.at_s=4", "fault.1.for_s=0.5", "fault.1.value=0.3"]


def test_of_one_fault_they_are_those_of_the_run() -> None:
    scenario = load("noisy", ["duration_s=4", "fault.at_s=2"])
    signals = signals_without_log(scenario)
    of_run, (of_fault,) = metrics(scenario, signals), fault_metrics(scenario, signals)
    pairs = {
        "deviation_peak_mps2": "deviation_peak_after_fault_mps2",
        "deviation_settled_mps2": "deviation_settled_after_fault_mps2",
        "error_peak_mps2": "error_peak_while_lost_mps2",
        "fault_estimate_peak_mps2": "fault_estimate_peak_while_lost_mps2",
        "unavoidable_deviation_mps2": "unavoidable_deviation_mps2",
        "suspected_after_s": "suspected_after_s",
        "detection_delay_s": "detection_delay_s",
        "missed_detection": "missed_detection",
    }
    assert {key: of_fault[key] for key in pairs} == {k: of_run[v] for k, v in pairs.items()}
    assert of_fault["kind"] == "actuator-dead"
    assert of_fault["deviation_peak_mps2"] > 0.01


def test_what_one_fault_does_is_told_from_what_the_other_does() -> None:
    """The other one is over before, or has not begun: each has what it does alone."""
    scenario = load("ideal", BOTH)
    dead, stuck = fault_metrics(scenario, signals_without_log(scenario))
    alone = load("ideal", [*BOTH[:3], "duration_s=3.9"])
    (dead_alone,) = fault_metrics(alone, signals_without_log(alone))
    assert dead["detection_delay_s"] == dead_alone["detection_delay_s"]
    assert dead["deviation_peak_mps2"] != dead_alone["deviation_peak_mps2"]  # it goes on to 6 s
    assert dead["error_peak_mps2"] == dead_alone["error_peak_mps2"]
    assert stuck["detection_delay_s"] is stuck["missed_detection"] is None  # no channel is lost
    car = signals_without_log(scenario).plant["true_dstar_mps2"]
    others = load("ideal", ["duration_s=6", *BOTH[1:3]])
    without = signals_without_log(others).plant["true_dstar_mps2"]
    assert stuck["deviation_peak_mps2"] == pytest.approx(np.abs(car - without)[4000:].max(), 1e-6)


@pytest.mark.parametrize("kind", ["sensor-stuck", "frames-missing"])
def test_d_of_the_car_is_its_own_where_the_sensor_hides_it(kind: str) -> None:
    settings = [f"fault.kind={kind}", "fault.channel=sensor", "fault.value=0.5", "fault.at_s=0.1"]
    scenario = load("ideal", [*settings, "duration_s=0.3", "fault.for_s=0.1"])
    signals = signals_without_log(scenario)
    output = output_of_car(scenario, signals)
    np.testing.assert_array_equal(output[100:200], signals.plant["true_dstar_mps2"][100:200])
    np.testing.assert_array_equal(output[:100], signals.dstar_mps2[:100])
    unknown = quiet(scenario)
    assert np.flatnonzero(np.isnan(output_of_car(scenario, unknown))).tolist() == [*range(100, 200)]


def test_a_fault_after_the_end_has_no_figures() -> None:
    scenario = load("ideal", ["duration_s=0.2"])
    (none,) = fault_metrics(scenario, quiet(scenario))
    what = {"kind": "actuator-dead", "place": "torque", "at_s": 10.0, "for_s": None}
    assert {key: value for key, value in none.items() if value is not None} == {
        key: value for key, value in what.items() if value is not None
    }


def test_the_closing_table_has_a_line_for_each_of_several_faults() -> None:
    scenario = load("ideal", BOTH)
    faults = fault_metrics(scenario, signals_without_log(scenario))
    dead, stuck = fault_rows(scenario, faults)
    assert dead[0] == "steering torque lost from 2 s to 3.5 s (actuator dead)"
    assert dead[1].endswith(f"m/s², confirmed after {faults[0]['detection_delay_s']:g} s")
    assert stuck[0] == "D* stuck at 0.3 m/s² from 4 s to 4.5 s (sensor stuck)"
    assert stuck[1] == f"deviation up to {faults[1]['deviation_peak_mps2']:.4g} m/s²"
    assert fault_rows(load("ideal"), faults[:1]) == []
