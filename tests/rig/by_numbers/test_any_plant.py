"""Unstable and non-minimum-phase plants, whole scenarios: against python-control on its own."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from can_rig.assessment.limitations import describe, plant_limitations
from can_rig.assessment.stability import check_stability, refuse_unstable
from can_rig.assessment.tuning.candidate import Values, cars_of
from can_rig.assessment.tuning.search import tune
from can_rig.errors import ScenarioError
from can_rig.plant.frameless import frameless
from can_rig.results.counterfactual import signals_without_log
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD, margins
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.law.status import FaultState
from tests.rig.by_numbers.by_control import loop, step_response
from tests.rig.by_numbers.plants import PLANTS, written

NAMES = ("nonminimum-phase", "oversteering", "pendulum", "satellite")
LINEAR = (
    "design.compensation=always", "design.estimator=zoh", "plant.sensor.noise_mps2=0",
    "duration_s=3", "fault.at_s=1.5", "limits.torque_nm=1e9", "limits.force_difference_n=1e9",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_the_step_the_loss_and_its_peak_are_python_controls(name):
    scenario = load(name, LINEAR)
    table = controller_table(scenario, None)
    left = np.ones((scenario.ticks, 2))
    left[round(scenario.loss.at_s / scenario.tick_s) :, 0] = 0.0
    drive = np.full(scenario.ticks, scenario.reference.amplitude_mps2)
    plant = sample(continuous_plant(scenario.plant), scenario.tick_s)
    run = simulate(table, plant, drive, effectiveness=left)
    own = (run.measurement, run.command_1, run.command_2, run.fault_estimate)
    for ours, theirs in zip(own, step_response(scenario), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-8 * np.abs(theirs).max())


@pytest.mark.parametrize(
    ("left", "compensation"), [(HEALTHY, "off"), (HEALTHY, "always"), (TORQUE_DEAD, "always")]
)
@pytest.mark.parametrize("name", [*NAMES, *PLANTS])
def test_the_margins_are_python_controls(name, left, compensation, tmp_path):
    file = written(tmp_path, name) if name in PLANTS else name
    scenario = load(file, (*LINEAR, f"design.compensation={compensation}"))
    table, plant = controller_table(scenario, None), continuous_plant(scenario.plant)
    found = margins(table, plant, scenario.tick_s, left)
    whole = loop(scenario, left)
    omega = np.geomspace(1e-2, 0.999 * np.pi / scenario.tick_s, 4000)
    sensitivity = np.abs(whole.frequency_response(omega).frdata[4, 1])
    assert found.peak_sensitivity == pytest.approx(sensitivity.max(), rel=1e-3)
    least = plant_limitations(scenario)["healthy" if left == HEALTHY else "faulted"]
    assert found.peak_sensitivity >= least.sensitivity
    for gain, stable in ((0.999 * found.gain_margin, True), (1.001 * found.gain_margin, False)):
        assert bool(np.abs(loop(scenario, left, gain).poles()).max() < 1.0) is stable
    assert found.spectral_radius == pytest.approx(np.abs(whole.poles()).max(), abs=1e-6)


def said(scenario: Scenario) -> str:
    """The lines of ``check`` on what the plant makes impossible."""
    return " ".join(describe(scenario, plant_limitations(scenario)))


def test_check_says_what_zeros_and_poles_make_impossible():
    assert said(load("nonminimum-phase")) == (
        "plant: zeros from X_diff at 2.37 ± 20.1j rad/s: for any compensation a loss can be "
        "halved up to 20.2 rad/s at most, or it is more than doubled elsewhere"
    )
    assert said(load("pendulum")) == (
        "plant: unstable: poles at 4.33 rad/s double a motion of angle every 0.16 s"
    )
    assert "poles at 0.694 ± 4j rad/s double a motion of D* every 1 s" in said(load("oversteering"))
    assert said(load("satellite")) == (
        "plant: integrates: to hold angle takes no wheel, and a loss shows once there is some again"
    )
    swinging = ["plant.a=[[0, 1], [-9, 0]]", "budget.box=0"]
    assert said(load("pendulum", swinging)) == (
        "plant: swings: nothing damps the motion of angle at 3 rad/s"
    )
    assert said(load("default")) == ""


RIGHT_ZERO = ("plant.kind=transfer-functions", "plant.g2.poles=[2, -7]", "plant.g2.gain=4",
              "plant.g2.zeros=[]", "plant.g1.poles=[2, -5, -9]", "plant.g1.gain=-3",
              "budget.box=0", "design.alpha=2")  # fmt: skip


def test_a_zero_near_a_pole_is_said_to_cost_much():
    settings = (*RIGHT_ZERO, "plant.g1.zeros=[6]", "latency_ticks=20")
    words = said(load("thesis-step", settings))
    assert "|T| peaks at 2.08 or more" in words  # (6 + 2)/(6 - 2) e^(2·0.02)
    assert "for any controller a deviation cannot be halved at any frequency" in words
    assert "|S| peaks at 2 or more, 2 after the loss" in words


REFUSED = {
    "design.feedback=false": "must have real part < 0 without feedback",
    "plant.a=[[0, 1], [0, -0.2]] plant.c=[0, 1]": "no input moves the output through .* at 0 rad/s",
    "plant.b=[[0, 0], [4, 0]]": "G2.s. is identically zero",
    f"plant.b=[[0, 1], [4, {-0.1 - math.sqrt(19.63)}]]": "input 2 does not reach the unstable mode",
}


@pytest.mark.parametrize("setting", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(setting):
    with pytest.raises(ScenarioError, match=REFUSED[setting]) as refused:
        controller_table(load("pendulum", re.split(r" (?=plant)", setting)), None)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("gains", [(1.2, 1.0), (0.8, 1.2), (1.1, 1.1), (0.9, 0.8)])
def test_another_pendulum_is_not_taken_for_a_loss(gains):
    """With ``budget.box = 0`` these are, and the second and third fall after the loss."""
    own = ["duration_s=5", "fault.at_s=3.5", "budget.box=0.2", "model.b=[[0, 0], [4, 2]]"]
    scenario = load("pendulum", [*own, f"plant.b=[[0, 0], [{4 * gains[0]}, {2 * gains[1]}]]"])
    trace = frameless(scenario)
    confirmed = np.flatnonzero(trace.fault_state == FaultState.CONFIRMED)
    assert 3.5 < confirmed[0] * scenario.tick_s < 3.6
    assert np.abs(trace.error[-500:]).max() < 0.1 * scenario.reference.amplitude_mps2


TUNINGS: dict[str, list[Values]] = {
    "pendulum": [(0.0033, 3, 0.0022, 3), (0.003, 3, 0.06, 3), (0.0033, 3, 0.018, 3)],
    "oversteering": [(0.001, 2, 0.01, 3), (0.006, 2, 0.2, 3), (0.01, 2, 5.0, 3)],
    "nonminimum-phase": [(0.001, 1, 0.01, 2), (0.05, 1, 0.1, 2), (0.0047, 1, 0.1, 3)],
    "satellite": [(0.003, 3, 0.02, 3), (0.003, 4, 0.5, 4), (0.05, 3, 1.0, 3)],
}
"""Of each, one that does not hold the plant, and two that do."""


@pytest.mark.parametrize("name", NAMES)
def test_tune_tells_what_holds_the_plant_and_costs_least(name):
    scenario = load(name)
    found = tune(scenario, cars_of(scenario, 0.0), candidates=TUNINGS[name])
    peaks = [tuning.peak_mps2 for tuning in found.front]
    assert len(peaks) == 2 and peaks[0] < 0.7 * peaks[1]
    assert sum(found.refusals.values()) == 1
    assert check_stability(replace(scenario, design=found.chosen.design)).stable


def test_the_tuning_that_is_named_for_an_unstable_car_holds_it():
    car = ("plant.speed_mps=60", "plant.rear_cornering_stiffness_n_per_rad=1e3")
    with pytest.raises(ScenarioError, match=r"unstable \(healthy\)") as refused:
        refuse_unstable(load("thesis-step", car))
    settings = re.findall(r"--set (\S+)", str(refused.value))
    assert len(settings) == 3
    refuse_unstable(load("thesis-step", [*car, *settings]))


def test_a_channel_that_is_zero_is_called_so_beside_one_that_integrates():
    with pytest.raises(ScenarioError, match=r"G1\(s\) is identically zero"):
        continuous_plant(load("satellite", ["plant.g1.num=[0]"]).plant)


def test_a_bias_of_the_sensor_fades_from_the_fault_estimate_of_an_integrating_plant():
    """As the step response of (s/(s + λ))², λ = 0.1/τq: whatever C makes of it, d̂ knows of."""
    keys = ("fault.kind=sensor-biased", "fault.bias_mps2=0.01", "fault.at_s=1", "duration_s=13")
    scenario = load("satellite", ("reference.amplitude_mps2=0", "plant.sensor.noise_mps2=0", *keys))
    run = signals_without_log(scenario)
    since_s = run.time_s[run.time_s >= 1.0] - 1.0
    fading = 0.1 / scenario.design.tau_q_s * since_s
    expected = -0.01 * (1.0 - fading) * np.exp(-fading)
    np.testing.assert_allclose(
        run.fault_estimate_mps2[run.time_s >= 1.0], expected, atol=1e-4, rtol=0
    )


def test_what_no_tuning_holds_is_not_told_to_be_tuned():
    """An integrating plant without a wheel and without compensation drifts, however it is tuned."""
    with pytest.raises(ScenarioError, match=r"wheel dead.*nothing holds it then") as refused:
        refuse_unstable(load("satellite", ["design.compensation=off"]))
    assert "tau_q_s" not in str(refused.value)
