"""The numbers of a run, against the continuous loop and by hand."""

from dataclasses import replace

import numpy as np
import pytest

from can_rig.assessment.stability import check_stability
from can_rig.results.counterfactual import fault_free, output_of_car, signals_without_log
from can_rig.results.metrics import Metrics, fault_metrics, fault_rows, metrics, rows, windows
from can_rig.results.signals import Signals
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from can_rig.thesis.continuous import solve
from tests.rig.results.quiet import COLUMNS, quiet

LSB_MPS2 = 1e-8


@pytest.mark.parametrize(("name", "within"), [("thesis-step", 0.08), ("chapter-2", 0.01)])
def test_deviation_is_that_of_the_continuous_loop(run, name, within):
    scenario, signals = run(name, "duration_s=3.0", "fault.at_s=1.5")
    lost, kept = solve(scenario), solve(scenario.healthy)
    expected = np.abs(lost.measurement - kept.measurement).max()
    values = metrics(scenario, signals)
    assert values["deviation_peak_after_fault_mps2"] == pytest.approx(expected, rel=within)
    assert (values["error_peak_after_fault_mps2"] is None) == (name == "chapter-2")


def test_a_fault_where_nothing_acts_changes_nothing(run):
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
        ([], 0, 1000, None),  # the loss found it ended
        ([], 1500, 2000, None),  # only after its return
        ([], 1200, 1201, True),
        (["latency_ticks=2"], 0, 998, None),
        (["latency_ticks=2"], 0, 999, True),  # on its way when the actuator died
    ],
)
def test_a_lost_force_difference_is_missed_only_where_it_acted(settings, first, last, missed):
    lost = ["fault.channel=force-difference", "fault.at_s=1.0", "fault.for_s=0.5"]
    scenario = load("thesis-step", ["duration_s=2.0", *lost, *settings])
    force = np.zeros(scenario.ticks)
    force[first:last] = -5.0
    values = metrics(scenario, quiet(scenario, force_difference_n=force))
    assert values["missed_detection"] is missed


def test_what_the_force_difference_can_carry_is_said_where_the_torque_is_lost():
    keys = ("dstar_carried_mps2", "force_difference_needed_n", "force_difference_available_n")
    for settings, there in ((["fault.channel=torque"], True), (["fault.kind=none"], False),
                            (["fault.channel=force-difference"], False),
                            (["fault.kind=sensor-biased"], False)):  # fmt: skip
        scenario = load("default", ["tick_s=0.01", *settings])
        values = metrics(scenario, quiet(scenario))
        assert [values[key] is not None for key in keys] == [there] * 3


def test_a_biased_sensor_leaves_the_error_of_the_car(run):
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


def test_the_tick_at_which_a_bias_comes_is_no_jump_of_the_car(run):
    scenario, signals = run(
        "ideal", "fault.kind=sensor-biased", "fault.at_s=0.05", "duration_s=0.051"
    )
    peak = metrics(scenario, signals)["deviation_peak_after_fault_mps2"]
    assert signals.dstar_mps2[-1] - signals.dstar_mps2[-2] > 0.09
    assert peak is not None and peak < 20 * LSB_MPS2


def test_a_passing_fault_is_over_at_the_end(run):
    scenario, signals = run("thesis-step", "fault.at_s=1.0", "fault.for_s=0.5", "duration_s=6.0")
    values = metrics(scenario, signals)
    assert values["fault_estimate_peak_while_lost_mps2"] == pytest.approx(1.0, rel=0.1)
    settled = values["fault_estimate_settled_mps2"]
    assert settled is not None and settled < 1e-3
    force = values["force_difference_settled_n"]
    assert force is not None and force < 10.0


def test_noise_in_the_commands_is_that_of_the_exact_covariance(run):
    always = ("design.compensation=always", "design.tau_s=0.0022", "design.alpha=2")
    scenario, signals = run("noisy", "duration_s=10.0", "fault.kind=none", *always)
    expected = (
        check_stability(scenario).healthy.noise_to_command_2 * scenario.plant.sensor.noise_mps2
    )
    found = metrics(scenario, signals)["force_difference_noise_rms_n"]
    assert found == pytest.approx(expected, rel=0.15)  # 2 s of a noise of some ms


def test_what_counts_from_the_fault_on_counts_after_its_end_too():
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


def test_peaks_belong_to_their_windows():
    settings = ["tick_s=0.01", "fault.for_s=5"]
    scenario = load("thesis-step", settings)
    reference = np.zeros(scenario.ticks)
    for tick, error in (
        (100, 9.0), (990, 1.0), (1000, -7.0), (1499, 2.0), (1500, 8.0), (1990, 3.0),
    ):  # fmt: skip
        reference[tick] = error
    values = metrics(scenario, quiet(scenario, reference_mps2=reference))
    assert values["error_before_fault_mps2"] == 1.0
    assert values["error_peak_while_lost_mps2"] == 7.0
    assert values["error_peak_after_fault_mps2"] == 8.0
    assert values["error_settled_after_fault_mps2"] == 3.0


def test_what_has_settled_is_after_the_fault_and_without_a_fault_at_the_end():
    scenario = load("thesis-step", ["tick_s=0.01"])
    force = np.repeat([5.0, -7.0], 1000)
    for each, settled in ((scenario, 7.0), (scenario.healthy, 7.0)):
        values = metrics(each, quiet(each, force_difference_n=force))
        assert values["force_difference_settled_n"] == settled


def test_a_ratio_is_that_of_its_two_numbers(run):
    values = metrics(*run("default", "fault.at_s=0.5", "duration_s=1.0"))
    for ratio, value, least in (
        ("detection_over_unavoidable", "detection_delay_s", "unavoidable_detection_delay_s"),
        (
            "deviation_over_unavoidable",
            "deviation_peak_after_fault_mps2",
            "unavoidable_deviation_mps2",
        ),
    ):
        assert values[ratio] * values[least] == pytest.approx(values[value])


def labels(scenario: Scenario, values: Metrics) -> str:
    return "\n".join(f"{label}: {text}" for label, text in rows(values, scenario.plant))


def test_rows_say_only_what_the_run_has():
    scenario = load("thesis-step", ["tick_s=0.01"])
    acting = quiet(scenario, torque_nm=np.full(scenario.ticks, 40.0))
    closed = labels(scenario, metrics(scenario, acting))
    assert "|error| after the fault, peak: 0 m/s²" in closed
    assert "deviation" in closed and "loss confirmed after: missed" in closed
    before: Metrics = {"deviation_peak_after_fault_mps2": 0.1, "missed_detection": False}
    assert "loss confirmed after: confirmed before it" in labels(scenario, before)
    told = labels(scenario, before | {"false_alarms": 0})
    assert "loss confirmed after: compensated without a confirmation" in told
    healthy = scenario.healthy
    without = labels(healthy, metrics(healthy, quiet(healthy)))
    assert "|error|, settled: 0 m/s²" in without
    assert not any(word in without for word in ("after", "before", "deviation", "missed", "None"))
    other = load("chapter-2", ["tick_s=0.01"])
    opened = labels(other, metrics(other, quiet(other)))
    assert "error" not in opened and "deviation" in opened


def test_a_run_without_a_tick_has_no_numbers():
    scenario = load("thesis-step")
    empty = Signals(*(np.empty(0) for _ in COLUMNS))
    values = metrics(scenario, empty)
    assert set(values.values()) == {None}
    assert rows(values, load("thesis-step").plant) == []


def test_every_key_says_its_unit():
    scenario = load("thesis-step", ["tick_s=0.01"])
    for key in metrics(scenario, quiet(scenario)):
        plain = {"deviation_over_unavoidable", "detection_over_unavoidable"}
        plain |= {"missed_detection", "false_alarms", "suspicions", "deviation_over_uncompensated"}
        plain |= {"place", "verdict", "right_place", "wrong_place"}
        assert key.endswith(("_mps2", "_mps", "_s", "_m", "_nm", "_n", "_per_hour")) or key in plain


def spans(scenario: Scenario) -> dict[str, tuple[float, float] | None]:
    """First and last time of every window, s."""
    signals = quiet(scenario)
    found = {}
    for name, mask in vars(windows(scenario, signals)).items():
        inside = signals.time_s[mask]
        found[name] = (round(inside[0], 6), round(inside[-1], 6)) if len(inside) else None
    return found


def test_windows_of_a_lasting_fault():
    assert spans(load("thesis-step", ["tick_s=0.01"])) == {
        "before": (0.0, 9.99),
        "after": (10.0, 19.99),
        "active": (10.0, 19.99),
        "lost": (10.0, 19.99),
        "settled_before": (7.99, 9.99),
        "settled_after": (17.99, 19.99),
    }


def test_windows_of_a_passing_fault_settle_after_it_has_passed():
    found = spans(load("thesis-step", ["tick_s=0.01", "fault.for_s=9"]))
    assert found["lost"] == (10.0, 18.99)
    assert found["after"] == (10.0, 19.99)
    # Half of the second that is left: its first half is the transient of the return.
    assert found["settled_after"] == (19.5, 19.99)
    # The tick of its end is the first without it: 10 ms, 5 ms, half of either, and zero.
    settings = ["tick_s=0.005", "duration_s=20"]
    for for_s, first_s in ((9.985, 19.99), (9.995, 19.995)):
        passed = spans(load("thesis-step", [*settings, f"fault.for_s={for_s}"]))
        assert passed["settled_after"] == (first_s, 19.995)


@pytest.mark.parametrize("for_s", [None, 1.0])
def test_windows_of_two_faults_settle_after_the_last_change(for_s):
    """A first fault that lasts or is over, and a second one a second before the end."""
    first = [] if for_s is None else [f"fault.for_s={for_s}"]
    second = ["fault.1.kind=sensor-biased", "fault.1.at_s=19"]
    found = spans(load("thesis-step", ["tick_s=0.01", *first, *second]))
    assert found["after"] == (10.0, 19.99)
    assert found["settled_after"] == (19.5, 19.99)


def test_two_periods_of_a_slow_reference_count_as_settled():
    settings = ["tick_s=0.01", "reference.frequency_rad_per_s=3.141592653589793"]
    assert spans(load("thesis-sine", settings))["settled_after"] == (15.99, 19.99)
    endless = ["tick_s=0.01", "reference.frequency_rad_per_s=1e-300"]  # a half of the time at most
    assert spans(load("thesis-sine", endless))["settled_after"] == (15.0, 19.99)


@pytest.mark.parametrize("settings", [["fault.kind=none"], ["duration_s=2.0"]])
def test_windows_without_a_fault(settings):
    found = spans(load("thesis-step", ["tick_s=0.01", *settings]))
    assert found["after"] is found["lost"] is found["settled_after"] is None
    assert found["before"] is not None


def test_the_fault_is_lost_at_the_ticks_at_which_the_nodes_lose_it():
    """Binary fractions of a second must not shift it by a tick."""
    for at in range(1, 1500, 7):
        scenario = load("thesis-step", ["duration_s=2.0", f"fault.at_s={at / 1000}"])
        lost = windows(scenario, quiet(scenario)).lost
        assert np.flatnonzero(lost).tolist() == list(range(at, scenario.ticks))


BOTH = ["duration_s=6", "fault.at_s=2", "fault.for_s=1.5", "fault.1.kind=sensor-stuck"]
BOTH += ["fault.1.at_s=4", "fault.1.for_s=0.5", "fault.1.value=0.3"]


def test_of_one_fault_they_are_those_of_the_run():
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


def test_what_one_fault_does_is_told_from_what_the_other_does():
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
def test_d_of_the_car_is_its_own_where_the_sensor_hides_it(kind):
    settings = [f"fault.kind={kind}", "fault.channel=sensor", "fault.value=0.5", "fault.at_s=0.1"]
    scenario = load("ideal", [*settings, "duration_s=0.3", "fault.for_s=0.1"])
    signals = signals_without_log(scenario)
    output = output_of_car(scenario, signals)
    np.testing.assert_array_equal(output[100:200], signals.plant["true_dstar_mps2"][100:200])
    np.testing.assert_array_equal(output[:100], signals.dstar_mps2[:100])
    unknown = quiet(scenario)
    assert np.flatnonzero(np.isnan(output_of_car(scenario, unknown))).tolist() == [*range(100, 200)]


def test_a_fault_after_the_end_has_no_figures():
    scenario = load("ideal", ["duration_s=0.2"])
    (none,) = fault_metrics(scenario, quiet(scenario))
    what = {"kind": "actuator-dead", "place": "torque", "at_s": 10.0, "for_s": None}
    assert {key: value for key, value in none.items() if value is not None} == {
        key: value for key, value in what.items() if value is not None
    }


def test_the_closing_table_has_a_line_for_each_of_several_faults():
    scenario = load("ideal", BOTH)
    faults = fault_metrics(scenario, signals_without_log(scenario))
    dead, stuck = fault_rows(scenario, faults)
    assert dead[0] == "steering torque lost from 2 s to 3.5 s (actuator dead)"
    assert dead[1].endswith(f"m/s², confirmed after {faults[0]['detection_delay_s']:g} s")
    assert stuck[0] == "D* stuck at 0.3 m/s² from 4 s to 4.5 s (sensor stuck)"
    assert stuck[1] == f"deviation up to {faults[1]['deviation_peak_mps2']:.4g} m/s²"
    assert fault_rows(load("ideal"), faults[:1]) == []
