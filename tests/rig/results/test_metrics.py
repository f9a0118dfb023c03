"""The numbers of a run, against the continuous loop and by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.assessment.stability import check_stability
from can_rig.results.counterfactual import fault_free
from can_rig.results.metrics import Metrics, metrics, rows
from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario
from can_rig.thesis.continuous import solve
from tests.rig.results.quiet import COLUMNS, Run, quiet

LSB_MPS2 = 1e-8


@pytest.mark.parametrize(("name", "within"), [("thesis-step", 0.08), ("chapter-2", 0.01)])
def test_deviation_is_that_of_the_continuous_loop(run: Run, name: str, within: float) -> None:
    scenario, signals = run(name, "duration_s=3.0", "fault.at_s=1.5")
    lost, kept = solve(scenario), solve(scenario.healthy)
    expected = np.abs(lost.measurement - kept.measurement).max()
    values = metrics(scenario, signals)
    assert values["deviation_peak_after_fault_mps2"] == pytest.approx(expected, rel=within)
    assert (values["error_peak_after_fault_mps2"] is None) == (name == "chapter-2")


def test_a_fault_where_nothing_acts_changes_nothing(run: Run) -> None:
    """Channel 2 idles in a settled healthy loop, so losing it is not seen."""
    scenario, signals = run(
        "thesis-step", "fault.channel=force-difference", "fault.at_s=1.5", "duration_s=2.0"
    )
    values = metrics(scenario, signals)
    deviation = values["deviation_peak_after_fault_mps2"]
    assert deviation is not None and deviation < 1e-6
    assert values["detection_delay_s"] is None
    assert ("loss confirmed after", "missed") in rows(values, load("thesis-step").plant)


@pytest.mark.parametrize(
    ("settings", "first", "last", "missed"),
    [
        ([], 0, 0, None),
        ([], 0, 1000, None),  # not any more when it was lost
        ([], 1500, 2000, None),  # only when it had come back
        ([], 1200, 1201, True),
        (["latency_ticks=2"], 0, 998, None),
        (["latency_ticks=2"], 0, 999, True),  # on its way when the actuator died
    ],
)
def test_a_lost_force_difference_is_missed_only_where_it_acted(
    settings: list[str], first: int, last: int, missed: bool | None
) -> None:
    lost = ["fault.channel=force-difference", "fault.at_s=1.0", "fault.for_s=0.5"]
    scenario = load("thesis-step", ["duration_s=2.0", *lost, *settings])
    force = np.zeros(scenario.ticks)
    force[first:last] = -5.0
    values = metrics(scenario, quiet(scenario, force_difference_n=force))
    assert values["missed_detection"] is missed


def test_what_the_force_difference_can_carry_is_said_where_the_torque_is_lost() -> None:
    keys = ("dstar_carried_mps2", "force_difference_needed_n", "force_difference_available_n")
    for settings, there in ((["fault.channel=torque"], True), (["fault.kind=none"], False),
                            (["fault.channel=force-difference"], False),
                            (["fault.kind=sensor-biased"], False)):  # fmt: skip
        scenario = load("default", ["tick_s=0.01", *settings])
        values = metrics(scenario, quiet(scenario))
        assert [values[key] is not None for key in keys] == [there] * 3


def test_a_biased_sensor_leaves_the_error_of_the_car(run: Run) -> None:
    """The loop holds the measured D*, so the car settles off by the bias, and comes back."""
    bias = -0.04
    biased = ["fault.kind=sensor-biased", f"fault.bias_mps2={bias}", "fault.at_s=1.5"]
    for name in ("ideal", "thesis-step"):
        scenario, signals = run(name, *biased, "duration_s=5.0")
        assert np.abs(signals.error_mps2[-1000:]).max() < 1e-3 * abs(bias)  # as measured
        values = metrics(scenario, signals)
        for key in ("error_settled_after_fault_mps2", "deviation_settled_after_fault_mps2"):
            assert values[key] == pytest.approx(abs(bias), rel=1e-2)
        assert values["error_before_fault_mps2"] == pytest.approx(0.0, abs=1e-3)
    scenario, signals = run("ideal", *biased, "fault.for_s=1.0", "duration_s=5.0")
    values = metrics(scenario, signals)
    for key in ("error_settled_after_fault_mps2", "deviation_settled_after_fault_mps2"):
        assert values[key] == pytest.approx(0.0, abs=0.1 * abs(bias))


def test_the_tick_at_which_a_bias_comes_is_no_jump_of_the_car(run: Run) -> None:
    scenario, signals = run(
        "ideal", "fault.kind=sensor-biased", "fault.at_s=0.05", "duration_s=0.051"
    )
    peak = metrics(scenario, signals)["deviation_peak_after_fault_mps2"]
    assert signals.dstar_mps2[-1] - signals.dstar_mps2[-2] > 0.09
    assert peak is not None and peak < 20 * LSB_MPS2


def test_a_passing_fault_is_over_at_the_end(run: Run) -> None:
    scenario, signals = run("thesis-step", "fault.at_s=1.0", "fault.for_s=0.5", "duration_s=6.0")
    values = metrics(scenario, signals)
    assert values["fault_estimate_peak_while_lost_mps2"] == pytest.approx(1.0, rel=0.1)
    settled = values["fault_estimate_settled_mps2"]
    assert settled is not None and settled < 1e-3
    force = values["force_difference_settled_n"]
    assert force is not None and force < 10.0


CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = 0.0, 1.0, 2.0, 3.0


def test_noise_in_the_commands_is_that_of_the_exact_covariance(run: Run) -> None:
    always = ("design.compensation=always", "design.tau_s=0.0022", "design.alpha=2")
    scenario, signals = run("noisy", "duration_s=10.0", "fault.kind=none", *always)
    expected = (
        check_stability(scenario).healthy.noise_to_command_2 * scenario.plant.sensor.noise_mps2
    )
    found = metrics(scenario, signals)["force_difference_noise_rms_n"]
    assert found == pytest.approx(expected, rel=0.15)  # 2 s of noise that lasts for some ms


def test_what_counts_from_the_fault_on_counts_after_its_end_too() -> None:
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0", "fault.for_s=0.05"])
    reference, torque = np.zeros((2, scenario.ticks))
    reference[900:1100] = -0.5
    torque[[999, 1000, 1001, 1500]] = 90.0, 20.0, 70.0, -80.0
    signals = quiet(scenario, reference_mps2=reference, torque_nm=torque)
    values = metrics(scenario, signals)
    assert values["error_integral_after_fault_mps"] == pytest.approx(0.5 * 0.1)
    assert values["torque_at_fault_nm"] == 20.0
    assert values["torque_peak_after_fault_nm"] == 80.0
    dstar = fault_free(scenario, signals).car_mps2.copy()
    dstar[[999, 1030, 1700]] += 3.0, 1.0, 2.0
    moved = replace(signals, dstar_mps2=dstar)
    peak = metrics(scenario, moved)["deviation_peak_after_fault_mps2"]
    assert peak == pytest.approx(2.0, abs=1e-6)


def test_peaks_belong_to_their_windows() -> None:
    settings = ["tick_s=0.01", "fault.for_s=5"]
    scenario = load("thesis-step", settings)
    reference = np.zeros(scenario.ticks)
    for tick, error in (
        (100, 9.0),
        (990, 1.0),
        (1000, -7.0),
        (1499, 2.0),
        (1500, 8.0),
        (1990, 3.0),
    ):
        reference[tick] = error
    values = metrics(scenario, quiet(scenario, reference_mps2=reference))
    assert values["error_before_fault_mps2"] == 1.0
    assert values["error_peak_while_lost_mps2"] == 7.0
    assert values["error_peak_after_fault_mps2"] == 8.0
    assert values["error_settled_after_fault_mps2"] == 3.0


def labels(scenario: Scenario, values: Metrics) -> str:
    return "\n".join(f"{label}: {text}" for label, text in rows(values, scenario.plant))


def test_rows_say_only_what_the_run_has() -> None:
    scenario = load("thesis-step", ["tick_s=0.01"])
    acting = quiet(scenario, torque_nm=np.full(scenario.ticks, 40.0))
    closed = labels(scenario, metrics(scenario, acting))
    assert "|error| after the fault, peak: 0 m/s²" in closed
    assert "deviation" in closed and "loss confirmed after: missed" in closed
    before: Metrics = {"deviation_peak_after_fault_mps2": 0.1, "missed_detection": False}
    assert "loss confirmed after: confirmed before it" in labels(scenario, before)
    healthy = scenario.healthy
    without = labels(healthy, metrics(healthy, quiet(healthy)))
    assert "|error|, settled: 0 m/s²" in without
    assert not any(word in without for word in ("after", "before", "deviation", "missed", "None"))
    other = load("chapter-2", ["tick_s=0.01"])
    opened = labels(other, metrics(other, quiet(other)))
    assert "error" not in opened and "deviation" in opened


def test_a_run_without_a_tick_has_no_numbers() -> None:
    scenario = load("thesis-step")
    empty = Signals(*(np.empty(0) for _ in COLUMNS))
    values = metrics(scenario, empty)
    assert set(values.values()) == {None}
    assert rows(values, load("thesis-step").plant) == []


def test_every_key_says_its_unit() -> None:
    scenario = load("thesis-step", ["tick_s=0.01"])
    for key in metrics(scenario, quiet(scenario)):
        plain = {"deviation_over_unavoidable", "detection_over_unavoidable"}
        plain |= {"missed_detection", "false_alarms", "suspicions", "deviation_over_uncompensated"}
        plain |= {"place", "verdict", "right_place", "wrong_place"}
        assert key.endswith(("_mps2", "_mps", "_s", "_m", "_nm", "_n", "_per_hour")) or key in plain
