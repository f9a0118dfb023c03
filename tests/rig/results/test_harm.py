"""What compensation does to the car, against independent runs and a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from can_rig.logs.columns import TRUE_OUTPUT
from can_rig.plant.frameless import frameless
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.metrics import harm_metrics, metrics_of
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import FaultState, Verdict

SHORT = ["duration_s=3", "fault.at_s=1"]
UNCOMPENSATED = ["tick_s=0.01", "duration_s=3", "fault.kind=none", "design.compensation=off"]
GUST = 'disturbance={kind="gust", at_s=0.5, for_s=2, force_n=600, arm_m=0.3}'


def output(scenario: Scenario) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return frameless(scenario).measurement


@pytest.mark.parametrize("settings", [[], [GUST, "fault.kind=none"]])
def test_the_peaks_are_those_of_three_runs(settings):
    scenario = load("default", [*SHORT, *settings])
    off = load("default", [*SHORT, *settings, "design.compensation=off"])
    calm = replace(off, fault=(), disturbance=())
    values = metrics_of(scenario)
    peaks = [float(np.abs(output(each) - output(calm)).max()) for each in (scenario, off)]
    assert values["deviation_peak_mps2"] == peaks[0]
    assert values["deviation_peak_uncompensated_mps2"] == peaks[1] > 0.0
    assert values["deviation_over_uncompensated"] == peaks[0] / peaks[1]


@pytest.mark.parametrize("compensation", ["on-confirmation", "off"])
def test_a_healthy_car_without_alarms_deviates_from_nothing(compensation):
    values = metrics_of(
        load("ideal", ["duration_s=2", "fault.kind=none", f"design.compensation={compensation}"])
    )
    assert values["deviation_peak_mps2"] == values["astray_m"] == 0.0
    assert values["deviation_over_uncompensated"] is None
    assert values["compensated_unneeded_s"] == values["force_difference_unneeded_peak_n"] == 0.0
    assert (values["place"], values["verdict"]) == ("nothing", "NOTHING")
    assert (values["right_place"], values["wrong_place"]) == (None, False)


def test_two_deviations_below_a_step_of_the_frame_have_no_ratio():
    """A motor that has lost next to nothing moves the car by next to nothing, in either run."""
    values = metrics_of(load("ideal", [*SHORT, "fault.left=0.9999999999999"]))
    assert 0.0 < values["deviation_peak_uncompensated_mps2"] < 1e-8
    assert values["deviation_over_uncompensated"] is None


CAR = ("mass_kg", "speed_mps", "front_cornering_stiffness_n_per_rad",
       "rear_cornering_stiffness_n_per_rad")  # fmt: skip


DRIFTS = ["kind=actuator-drift", "at_s=2.6", "drift_per_s=4.145"]
DRIFTS_FASTER = ["kind=actuator-drift", "at_s=3.64681013", "drift_per_s=-14.0816562"]
HAS_A_PART = ["kind=actuator-dead", "at_s=3.6136251", "left=0.79596179"]
IS_OFF = ["kind=actuator-offset", "at_s=3.05318378", "offset=-43.0041177"]
ECHO_STICKS = ["kind=sensor-stuck", "at_s=3", "channel=torque-echo"]
SENSOR_SWINGS = ["kind=sensor-oscillating", "at_s=5.60357674", "amplitude=0.0958356959",
                 "frequency_rad_per_s=41.5904924"]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "car", "fault", "seed"),
    [("chassis-cluster", (1463, 8.73, 27029, 58627), DRIFTS, 3627014058),
     ("cluster", (1367.91619, 10.3964689, 39202.0824, 63121.4349), DRIFTS_FASTER, 479933305),
     ("chassis-cluster", (1524.40589, 10.8777166, 29594.8663, 62292.416), HAS_A_PART, 1566488579),
     ("cluster", (1155.39618, 11.5216376, 28737.8354, 58663.1416), IS_OFF, 1531566618),
     ("chassis-cluster", (1546, 11.62, 36448, 65226), ECHO_STICKS, 2550390054),
     ("cluster", (1196.60581, 10.8888451, 34494.9827, 55764.0306), SENSOR_SWINGS, 3252369109)],
)  # fmt: skip
def test_what_an_echo_tells_is_not_compensated_to_harm(name, car, fault, seed):
    """In cars that differ from the model, where a loss explains d̂ for a while."""
    end = max(float(fault[1].removeprefix("at_s=")) + 4.0, 7.0)
    drive = ["reference.kind=lane-change", "reference.frequency_rad_per_s=1.34"]
    drive += [f"duration_s={end}", f"seed={seed}", *(f"fault.{each}" for each in fault)]
    for key, believed, real in zip(CAR, (1400, 10, 33700, 56200), car, strict=True):
        drive += [f"model.{key}={believed}", f"plant.{key}={real}"]
    values = metrics_of(load(name, drive))
    uncompensated = values["deviation_peak_uncompensated_mps2"]
    assert values["deviation_peak_mps2"] <= 1.1 * uncompensated + 0.01


@pytest.mark.parametrize("at_s", [3.7, 4.1, 4.3, 4.6])
def test_a_motor_that_died_stays_compensated_against_an_echo_that_repeats_the_command(at_s):
    """A hanging drive repeats its command: whenever the command moves, its model lags behind."""
    lies = ["kind=sensor-lying", "channel=torque-echo", "at_s=3"]
    drive = [f"duration_s={at_s + 1.5}", f"fault.0.at_s={at_s}", *(f"fault.1.{it}" for it in lies)]
    values = metrics_of(load("cluster", drive))
    assert values["deviation_peak_mps2"] < 0.4 < values["deviation_peak_uncompensated_mps2"]


@pytest.mark.parametrize(
    ("reference", "fault"),
    [
        ("sine", ["kind=frames-missing", "at_s=4", "for_s=0.3"]),
        ("step", ["kind=actuator-dead", "at_s=4", "for_s=0.1"]),
        ("sine", ["kind=sensor-biased", "bias_mps2=0.2", "at_s=4", "for_s=2"]),
        ("step", ["kind=sensor-dead", "at_s=4", "for_s=0.3"]),
        ("sine", ["kind=sensor-dead", "at_s=4", "for_s=1"]),
    ],
)
def test_a_verdict_ends_with_its_fault(reference, fault):
    moves = ["duration_s=9", f"reference.kind={reference}", "reference.frequency_rad_per_s=2"]
    signals = signals_without_log(load("default", [*moves, *(f"fault.{it}" for it in fault)]))
    assert np.any(signals.verdict[4000:] > 0)
    assert (signals.verdict[-1], signals.fault_state[-1]) == (Verdict.NOTHING, FaultState.CLEAR)


@given(away=st.floats(-3.0, 3.0).filter(bool), begin=st.integers(0, 250))
def test_a_constant_deviation_leads_half_a_t_squared_astray(away, begin):
    """Within the two seconds of a driver, or what the run has of them."""
    scenario = load("thesis-step", UNCOMPENSATED)
    signals = signals_without_log(scenario)
    moved = signals.plant[TRUE_OUTPUT].copy()
    moved[begin:] += away
    signals = replace(signals, plant={TRUE_OUTPUT: moved})
    values = harm_metrics(scenario, signals)
    assert values["deviation_peak_mps2"] == pytest.approx(abs(away))
    n = min(300 - begin, 200)
    assert values["astray_m"] == pytest.approx(abs(away) * 1e-4 * n * (n + 1) / 2.0, abs=1e-8)


def test_x_diff_counts_as_unneeded_only_while_the_torque_works():
    scenario = load("default", ["duration_s=3", "fault.at_s=1", "fault.for_s=0.5"])
    signals = signals_without_log(scenario)
    values = harm_metrics(scenario, signals)
    spare = np.delete(signals.force_difference_n, slice(1000, 1500))
    assert values["force_difference_unneeded_peak_n"] == np.abs(spare).max() > 0.0
    rms = float(np.sqrt(np.mean(spare**2)))
    assert values["force_difference_unneeded_rms_n"] == pytest.approx(rms)
    seconds = 1e-3 * np.count_nonzero(np.abs(spare) > 40.0)  # 1 % of limits.force_difference_n
    assert values["compensated_unneeded_s"] == pytest.approx(seconds)
    assert values["torque_rms_nm"] == pytest.approx(np.sqrt(np.mean(signals.torque_nm**2)))


def test_a_log_without_reports_of_the_plant_has_no_true_deviation():
    scenario = load("default", SHORT)
    signals = replace(signals_without_log(scenario), plant={})
    values = harm_metrics(scenario, signals)
    assert values["deviation_peak_mps2"] is values["astray_uncompensated_m"] is None
    assert values["verdict"] == "TORQUE_LOST"


@pytest.mark.parametrize(
    ("codes", "settings", "verdict", "right", "wrong"),
    [([0, 1, 1, 4], ["fault.at_s=0"], "TORQUE_LOST", True, False),
     ([0, 1, 4, 4], ["fault.at_s=0"], "SENSOR_WRONG", False, True),
     ([7, 7, 7, 9], ["fault.at_s=0"], "CANNOT_BE_TOLD", False, False),
     ([7, 7, 7, 0], ["fault.at_s=0"], "NOTHING", False, False),
     ([0, 8, 8, 0], ["fault.at_s=0"], "BOTH_LOST", False, True),
     ([0, 3, 3, np.nan], ["fault.at_s=0", "fault.channel=force-difference"], "FORCE_LOST", True,
      False), ([0, 2, 0, 0], ["fault.kind=none"], "TORQUE_OFFSET", None, True),
     ([1, 1, 1, 4, 0, 0], ["fault.at_s=0.003"], "SENSOR_WRONG", False, True),
     ([0, 4, 4, 1], ["fault.at_s=0.004"], "SENSOR_WRONG", None, True),  # it is yet to come
     ([5, 1, 1, 1, 4, 4], ["fault.at_s=0.001", "fault.1.kind=sensor-biased", "fault.1.at_s=0.004",
                           "fault.1.bias_mps2=1"], "TORQUE_LOST", True, False)],
)  # fmt: skip
def test_the_longest_verdict_since_the_first_fault_is_right_or_wrong(
    codes, settings, verdict, right, wrong
):
    scenario = load("ideal", [f"duration_s={len(codes) / 1000}", *settings])
    signals = replace(signals_without_log(scenario), verdict=np.array(codes, dtype=np.float64))
    values = harm_metrics(scenario, signals)
    assert (values["verdict"], values["right_place"], values["wrong_place"]) == (
        verdict, right, wrong,
    )  # fmt: skip
