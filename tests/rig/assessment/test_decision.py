"""What ``check`` says of the decision, against drives with noise and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from can_rig.assessment.stability import decision_figures as figures
from can_rig.plant.frameless import frameless
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import FaultState, Verdict

STEADY_NM = 42.5  # for 1 m/s², docs/design.md
SEEDS = 31
CALM = "budget.disturbance_mps2=0"


def delays_s(scenario: Scenario) -> np.ndarray:
    at = round(scenario.loss.at_s / scenario.tick_s)
    found = []
    for seed in range(SEEDS):
        state = frameless(replace(scenario, seed=seed)).fault_state[at:]
        found.append(float(np.flatnonzero(state == FaultState.CONFIRMED)[0]) * scenario.tick_s)
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "settings", "slowest"),
    [
        ("default", ["duration_s=3.3", "fault.at_s=3"], 1.7),
        # With white noise alone the evidence grows as t^5: at 22 ± 3·√44 that is 1.14 times t.
        (
            "default",
            ["duration_s=3.3", "fault.at_s=3", "budget.box=0", "budget.actuator_box=0", CALM],
            1.2,
        ),
        ("noisy", ["duration_s=3.3", "fault.at_s=3"], 1.7),
        ("chassis-can", ["duration_s=6.6", "fault.at_s=6"], 1.7),
    ],
)
def test_the_expected_delay_is_the_median_of_noisy_drives(name, settings, slowest):
    scenario = load(name, settings)
    expected_s = figures(scenario).expected_delay_s
    assert expected_s is not None
    drives_s = delays_s(scenario)
    # The median of so few is off by a few ticks itself.
    assert float(np.median(drives_s)) == pytest.approx(expected_s, rel=0.1, abs=2 * scenario.tick_s)
    assert drives_s.max() <= slowest * expected_s + 2 * scenario.tick_s


def test_fewer_alarms_take_longer_and_a_loss_that_does_nothing_is_never_found():
    short = ["duration_s=3.5", "fault.at_s=3"]
    strict, lax = (
        figures(load("default", [*short, f"budget.false_alarms_per_hour={rate}"])).expected_delay_s
        for rate in (1e-6, 10.0)
    )
    assert strict is not None and lax is not None
    assert strict > lax
    for change in ("reference.amplitude_mps2=0", "fault.at_s=5"):
        nothing = figures(load("default", [*short, change]))
        assert nothing.expected_delay_s is None
        assert "is not found on average" in next(nothing.describe(load("default")))


def test_noise_and_rounding_add_up():
    """Uniform rounding to 2^-k has the variance of a step squared over twelve."""
    coarse = load("default", ["plant.sensor.resolution_mps2=0.02"])
    assert figures(coarse).noise_mps2 == pytest.approx(
        math.hypot(0.005, 0.02 / math.sqrt(12.0)), rel=1e-3
    )
    assert figures(load("default")).noise_mps2 == pytest.approx(0.005, rel=1e-3)


@pytest.mark.parametrize("disturbance_mps2", [0.0, 0.03])
def test_the_least_torque_is_the_one_below_which_the_state_is_cannot_tell(disturbance_mps2):
    """A second of a constant d of white noise σ has the evidence d²/σ² · 1 s/T: Λ there."""
    calm = f"budget.disturbance_mps2={disturbance_mps2}"
    scenario = load("default", ["duration_s=12", "fault.kind=none", calm])
    least_nm = figures(scenario).least_torque_nm
    evidence = math.log(3600.0 / (scenario.tick_s * 0.001))
    in_noise_nm = 0.005 * math.sqrt(evidence / 1000.0) * STEADY_NM
    if disturbance_mps2:
        assert least_nm > 2.0 * in_noise_nm
    else:
        assert least_nm == pytest.approx(in_noise_nm, rel=0.01)
    quiet = scenario.noise_free
    for times, state in ((0.5, FaultState.CANNOT_TELL), (2.0, FaultState.CLEAR)):
        reference = replace(quiet.reference, amplitude_mps2=times * least_nm / STEADY_NM)
        driven = replace(quiet, model=scenario.model, reference=reference)
        assert frameless(driven).fault_state[-1] == state


def test_half_of_the_torque_needs_twice_the_torque_and_the_words_say_so():
    settings = ["duration_s=3.3", "fault.at_s=3"]
    whole = load("default", settings)
    half = load("default", [*settings, "fault.left=0.5"])
    assert figures(half).least_torque_nm == pytest.approx(2.0 * figures(whole).least_torque_nm)
    assert "the loss of 50% of the torque in" in next(figures(half).describe(half))
    assert "the loss of the torque in" in next(figures(whole).describe(whole))
    sensor = load("default", [*settings, "fault.left=0.5", "fault.kind=sensor-dead"])
    assert figures(sensor) == figures(whole)


def test_the_words_say_the_box():
    lines = list(figures(load("default")).describe(load("default")))
    assert "confirmed after" in lines[0] and "at most 0.001 false alarms an hour" in lines[0]
    assert lines[1] == "other cars: within ±20% of the model are not taken for a loss"
    none = list(figures(load("thesis-step")).describe(load("thesis-step")))
    assert "none (budget.box = 0): one that is not the model may be taken for a loss" in none[1]


@pytest.mark.long
@pytest.mark.parametrize("left", [0.5, 0.7])
def test_the_return_of_a_part_is_seen_in_a_bend_in_which_nothing_new_was_learnt(left):
    """Whatever the noise: the candidate that runs when the channel returns is of that time."""
    words = [f"fault.left={left}", "fault.at_s=4.7", "fault.for_s=4", "duration_s=10"]
    scenario = load("default", words)
    back, found = 8700, 0
    for seed in range(6):
        trace = frameless(replace(scenario, seed=seed))
        confirmed = trace.fault_state == FaultState.CONFIRMED
        found += int(confirmed[back])
        assert not confirmed[back + 300 :].any()
    assert found >= 3  # a loss of 30 % may look like a different car


@pytest.mark.parametrize("at_s", [2.5, 4.0, 5.3])
@pytest.mark.parametrize(("channel", "offset"), [("torque", 40.0), ("force-difference", 600.0)])
def test_an_offset_that_ends_leaves_no_loss_and_no_verdict(channel, offset, at_s):
    """Begin and end look like two faults, and the plant like neither."""
    words = ["reference.kind=sine", "reference.frequency_rad_per_s=2", "duration_s=12"]
    words += ["fault.kind=actuator-offset", f"fault.channel={channel}", f"fault.offset={offset}"]
    scenario = load("default", [*words, f"fault.at_s={at_s}", "fault.for_s=0.3"])
    trace = frameless(scenario)
    begun, over = round(at_s / scenario.tick_s), round((at_s + 3.0) / scenario.tick_s)
    assert trace.verdict[begun:over].any()
    harmless = Verdict.NOTHING, Verdict.ANOTHER_CAR  # another car changes no command
    assert np.isin(trace.verdict[over:], harmless).all()
    assert not (trace.fault_state[over:] == FaultState.CONFIRMED).any()
