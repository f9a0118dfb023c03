"""``can-rig check`` and the refusal of ``can-rig run``; what a loss needs and takes to show."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest
from scipy.linalg import toeplitz

from can_rig.assessment.limitations import ControlAuthority, control_authority, unavoidable
from can_rig.assessment.stability import check_stability, refuse_unstable, stable_tuning
from can_rig.errors import ScenarioError
from can_rig.plant.nonlinear_car import NonlinearCar
from can_rig.scenario import shipped
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD, margins
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law.structs import FloatArray
from tests.helpers import asked, refused, sets, succeeded

UNSTABLE = ("tick_s=0.01", "design.estimator=zoh")  # only with the torque dead
FAST = ("latency_ticks=8", "design.tau_s=0.0001", "design.tau_q_s=0.0001")  # in every state
LATER = ("latency_ticks=8", "design.tau_s=0.0005", "design.tau_q_s=0.001", "design.estimator=zoh",
         "design.compensation=always")  # fmt: skip
CAR = steer_by_wire()


@pytest.mark.parametrize("name", shipped())
def test_the_shipped_scenarios_are_stable_and_run(name):
    scenario = load(name)
    result = check_stability(scenario)
    assert result.stable
    assert result.verdict.startswith("stable")
    refuse_unstable(scenario)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("highway", ["design.compensation=off"]),
        *((name, ["design.compensation=always"]) for name in ("default", "oversteering")),
    ],
)
def test_an_integrator_among_slow_poles_is_left_open_all_the_same(name, settings):
    """Its eigenvalue is up to 1.6e-6 off 1, more or less by the processor."""
    lost = ["fault.kind=actuator-dead", "fault.channel=force-difference"]
    settings += [] if name == "highway" else [*lost, "latency_ticks=0"]
    assert check_stability(load(name, settings)).stable


def test_json_has_the_figures_of_both_ends():
    done = succeeded("check", "thesis-step", "--json")
    values = json.loads(done.stdout)
    assert values["stable"] is True
    table = build(design(CAR, DesignSpecification()), Target(1e-3))
    for name, left in (("healthy", HEALTHY), ("faulted", TORQUE_DEAD)):
        expected = margins(table, CAR, 1e-3, left)
        assert values[name]["spectral_radius"] == pytest.approx(expected.spectral_radius)
        assert values[name]["delay_margin_ticks"] == expected.delay_margin_ticks == 0


def refuse(text: str) -> None:
    raise AssertionError(f"{text} is no JSON")


@pytest.mark.parametrize("key", ["noise_mps2", "resolution_mps2"])
def test_noise_beyond_all_numbers_is_refused_by_its_key(key):
    line = refused("check", "default", "--set", f"plant.sensor.{key}=1e308")
    assert f"plant.sensor.{key} = 1e+308" in line


def test_noise_that_hides_every_loss_is_null_in_json():
    done = asked("check", "default", "--set", "plant.sensor.noise_mps2=1e6", "--json")
    assert done.stderr == ""
    values = json.loads(done.stdout, parse_constant=refuse)
    assert values["decision"]["expected_delay_s"] is None
    assert values["decision"]["noise_mps2"] == pytest.approx(1e6)


def test_an_unstable_loop_is_exit_status_1_and_still_json():
    done = asked("check", "thesis-step", *sets(*UNSTABLE), "--json")
    assert done.returncode == 1
    values = json.loads(done.stdout, parse_constant=refuse)
    assert values["stable"] is False
    assert values["healthy"]["spectral_radius"] < 1.0 < values["faulted"]["spectral_radius"]
    assert values["faulted"]["delay_margin_ticks"] is None


def test_a_person_sees_one_table_and_one_verdict(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    done = asked("check", "thesis-step", *sets(*UNSTABLE))
    lines = done.stdout.splitlines()
    assert done.returncode == 1
    for word in ("healthy", "torque dead", "torque 25%"):
        assert word in lines[0]
    assert max(len(line) for line in lines[:-1]) <= 80
    assert lines[-1].startswith("unstable (torque dead): the spectral radius is 1.3095")
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("settings", "state"),
    [(UNSTABLE, "torque dead"), ((*UNSTABLE, "fault.kind=none"), "torque dead"),
     (("tick_s=0.01",), "healthy"), (FAST, "healthy")],
)  # fmt: skip
def test_run_refuses_an_unstable_loop_and_says_what_works(settings, state):
    """Unstable healthy, after the fault, or after one that the scenario does not have."""
    message = refused("run", "thesis-step", *sets(*settings))
    assert f"unstable ({state}): the spectral radius is" in message
    assert "this tuning is stable with no latency_ticks" in message
    offered = message.split("; ")[-2].removesuffix(" works").replace("--set ", "").split()
    assert check_stability(load("thesis-step", [*settings, *offered])).stable
    assert asked("check", "thesis-step", *sets(*settings, *offered)).returncode == 0


def test_the_latency_that_a_tuning_survives_is_said():
    """Between stable and unstable by its own words."""
    with pytest.raises(ScenarioError, match=r"stable with latency_ticks up to (\d+);") as refused:
        refuse_unstable(load("thesis-step", LATER))
    found = re.search(r"up to (\d+)", str(refused.value))
    assert found is not None
    longest = int(found[1])
    refuse_unstable(load("thesis-step", [*LATER, f"latency_ticks={longest}"]))
    with pytest.raises(ScenarioError, match="unstable"):
        refuse_unstable(load("thesis-step", [*LATER, f"latency_ticks={longest + 1}"]))


def test_what_works_holds_after_each_fault_of_a_list():
    """The last fault loses the other channel, after which the scenario's latency is too long."""
    faults = ["fault.0.kind=actuator-dead", "fault.1.kind=actuator-dead"]
    scenario = load(
        "ideal", [*faults, "fault.1.channel=force-difference", "design.compensation=always"]
    )
    with pytest.raises(ScenarioError, match=r"unstable \(force-difference dead\)") as refused:
        refuse_unstable(scenario)
    found = re.search(r"stable with latency_ticks up to (\d+)", str(refused.value))
    assert found is not None
    assert int(found[1]) < scenario.latency_ticks


def test_a_tuning_too_fast_for_the_sensor_is_not_the_reason_for_a_refusal():
    """The search for a stable tuning passes over q̂ faster than the sensor's filter."""
    slow = ["plant.sensor.corner_hz=50", "design.alpha=3", "design.alpha_q=4"]
    settings = [*slow, "design.tau_s=0.005", "design.tau_q_s=0.002", "latency_ticks=40"]
    with pytest.raises(ScenarioError, match=r"unstable \(torque dead\).*design\.tau_q_s=\S+ works"):
        refuse_unstable(load("ideal", settings))


def test_run_takes_an_unstable_loop_when_told(tmp_path):  # type: ignore[no-untyped-def]
    settings = sets(*UNSTABLE, "duration_s=0.05")
    arguments = (*settings, "--in-process", "--out", tmp_path / "r")
    assert asked("run", "thesis-step", *arguments).returncode == 2
    assert not (tmp_path / "r").exists()
    assert asked("run", "thesis-step", *arguments, "--allow-unstable").returncode == 0


@pytest.mark.parametrize("kind", ["none", "actuator-dead", "frames-missing", "frames-corrupted"])
def test_every_kind_of_fault_ends_in_a_dead_channel(kind):
    assert not check_stability(load("thesis-step", [*UNSTABLE, f"fault.kind={kind}"])).stable
    other = check_stability(
        load("thesis-step", [*UNSTABLE, f"fault.kind={kind}", "fault.channel=force-difference"])
    )
    assert other.linear_stable  # without the force difference it is the torque loop alone
    assert "force-difference dead" in dict(other.states)


def test_the_cars_own_parameters_are_checked_not_the_models():
    """A heavy car under a controller for a light one is neither's own loop."""
    own = ["design.tau_s=0.01", "design.tau_q_s=0.02"]
    ours = check_stability(load("thesis-step", [*own, "plant.speed_mps=30", "model.speed_mps=10"]))
    for speed in (10, 30):
        matched = check_stability(load("thesis-step", [*own, f"plant.speed_mps={speed}"]))
        assert ours.healthy.spectral_radius != pytest.approx(matched.healthy.spectral_radius)


def test_a_class_is_loaded_and_the_margins_are_said_not_to_be_its_own():
    kind = "can_rig.plant.nonlinear_car:NonlinearCar"
    own = check_stability(load("default", [f"plant.kind={kind}"]))
    said = f"margins: of the linear car with its parameters, not of {kind}"
    assert list(own.notes).count(said) == 1
    linear = check_stability(load("default"))
    assert own.healthy == linear.healthy
    assert not any(note.startswith("margins") for note in linear.notes)


@pytest.mark.parametrize("command", ["check", "bus"])
def test_a_class_that_is_no_plant_is_refused_as_a_run_refuses_it(command):
    done = asked(command, "default", "--set", "plant.kind=nope:Nope")
    assert done.returncode == 2
    assert done.stdout == ""
    assert "plant.kind = 'nope:Nope': no module nope, neither installed" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    with pytest.raises(ScenarioError, match=r"^plant\.kind = 'nope:Nope': no module nope"):
        check_stability(load("default", ["plant.kind=nope:Nope"]))


def test_a_partial_loss_that_is_unstable_is_said_and_does_not_decide():
    result = check_stability(load("thesis-step"))
    shaky = dataclasses.replace(result.healthy, spectral_radius=1.1)
    odd = dataclasses.replace(result, partly_lost={**result.partly_lost, 0.5: shaky})
    assert odd.stable
    assert odd.verdict == "stable healthy and with torque dead, but not: torque 50%"


def test_no_tuning_is_said_where_there_is_none():
    scenario = load("thesis-step", ["latency_ticks=20", "tick_s=0.1"])
    assert stable_tuning(scenario) is None
    with pytest.raises(ScenarioError, match=r"no tau_q_s up to 0\.1 works"):
        refuse_unstable(scenario)


def test_a_loop_that_is_stable_with_nothing_to_spare_is_not_called_stable():
    """Of 1.5 ms ticks and two of latency, τ = 7 ms leaves 0.4 % of the distance to -1."""
    thin = ["tick_s=0.0015", "latency_ticks=2", "design.tau_s=0.007", "design.tau_q_s=0.0015"]
    done = asked("check", "thesis-step", *sets(*thin), "--json")
    assert done.returncode == 1
    values = json.loads(done.stdout)
    assert max(values[end]["peak_sensitivity"] for end in ("healthy", "faulted")) > 100.0
    assert max(values[end]["spectral_radius"] for end in ("healthy", "faulted")) < 1.0
    assert not values["stable"]
    (found,) = values["thin_margins"]
    assert "must be at most 5 (budget.peak_sensitivity)" in found


def test_how_thin_a_margin_may_be_is_a_key():
    own = ("budget.peak_sensitivity=2", "budget.spare_ticks=6")
    result = check_stability(load("ideal", own))
    assert result.thin_margins == [
        f"{name}: the spare ticks of delay are {spare} and must be at least 6 (budget.spare_ticks)"
        for name, spare in (("healthy", 5), ("torque dead", 4))
    ]
    assert result.verdict == "thin margin: " + "; ".join(result.thin_margins)
    assert not result.stable
    assert check_stability(load("ideal", ["budget.spare_ticks=4"])).stable


def of(*settings: str, name: str = "default") -> ControlAuthority:
    scenario = load(name, settings)
    found = control_authority(scenario)
    assert found is not None
    return found


def test_needs_what_the_settled_run_holds():
    """Trap 7: 2989 N per m/s² of the physics car, 3455 N of the published one."""
    assert of().needed_n == pytest.approx(2989.0, abs=1.0)
    assert of("plant.variant=published").needed_n == pytest.approx(3455.0, abs=1.0)
    assert of("reference.amplitude_mps2=-0.5").needed_n == pytest.approx(1494.6, abs=0.5)


def settled_dstar(force_difference_n: float, *settings: str) -> float:
    """D* of the nonlinear car after 30 s of X_diff alone, no torque on the column."""
    car, dstar = NonlinearCar(load("nonlinear-car", settings).plant), 0.0
    for _ in range(3000):
        dstar = car.advance(0.01, 0.0, force_difference_n)
    return dstar


@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_tires_end_where_the_nonlinear_car_slides(friction):
    """Below the limit X_diff holds what it should; a tenth above, the rear axle is gone."""
    setting = f"plant.friction={friction}"
    carried = of(setting, "limits.force_difference_n=20000").carries_mps2
    at = of(setting, f"reference.amplitude_mps2={0.9 * carried}")
    assert at.enough
    assert settled_dstar(at.needed_n, setting) == pytest.approx(0.9 * carried, rel=0.1)
    beyond = of(setting, f"reference.amplitude_mps2={1.1 * carried}")
    assert not beyond.enough
    sliding = settled_dstar(beyond.needed_n, setting)
    assert abs(sliding - 1.1 * carried) > 0.3 * carried


def test_the_smaller_of_limit_and_tires_counts():
    tight, wide = of("limits.force_difference_n=1000"), of("limits.force_difference_n=20000")
    assert tight.available_n == tight.limit_n == 1000.0
    assert not tight.enough
    assert tight.carries_mps2 == pytest.approx(1000.0 / 2989.0, rel=1e-3)
    assert wide.available_n == wide.tires_n < 4849.0  # μ m g l_f/(l_f + l_r), less what Y_r takes
    assert "NOT ENOUGH" in str(tight)
    assert "enough: " in str(wide)


def test_it_is_the_largest_of_the_reference_that_counts():
    assert of(name="lane-change").reference_mps2 == pytest.approx(1.0, rel=1e-4)
    assert of(name="lane-change").enough


def test_chapter_2_has_no_tires():
    scenario = load("chapter-2")
    assert control_authority(scenario) is None


STEADY_NM = 42.5  # for 1 m/s², docs/design.md


def acceleration_per_nm(scenario: Scenario) -> float:
    """D̈* that a torque of 1 N m causes at once, m/s⁴: C A B of a channel of relative degree 2."""
    plant = continuous_plant(scenario.plant)
    assert float(np.abs(plant.c @ plant.b[:, 0]).max()) == pytest.approx(0.0, abs=1e-12)
    return (plant.c @ plant.a @ plant.b[:, 0]).item()


@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize("left", [0.0, 0.5])
def test_without_noise_it_is_what_the_loss_does_until_the_next_command_acts(latency, left):
    """One tick to show and ``latency`` more to act: a constant acceleration from rest."""
    scenario = load("ideal", [f"latency_ticks={latency}", f"fault.left={left}"])
    found = unavoidable(scenario, np.full(50, STEADY_NM))
    assert found is not None
    assert found.detection_ticks == 1
    acts_s = (latency + 1) * 1e-3
    expected = 0.5 * acceleration_per_nm(scenario) * (1.0 - left) * STEADY_NM * acts_s**2
    assert found.deviation_mps2 == pytest.approx(expected, rel=0.05)


def responses(scenario: Scenario, command: float, ticks: int) -> FloatArray:
    """Step response of G1 times ``command``, by its residues: no state and no sampling."""
    plant = continuous_plant(scenario.plant)
    poles, vectors = np.linalg.eig(plant.a)
    weights = (plant.c @ vectors).ravel() * np.linalg.solve(vectors, plant.b[:, 0])
    times = scenario.tick_s * np.arange(1, ticks + 1)
    return np.real(np.expm1(np.outer(times, poles)) @ (weights / poles)) * command


@pytest.mark.parametrize("noise", [0.001, 0.005, 0.05])
def test_with_noise_the_loss_shows_when_its_evidence_is_that_of_the_allowed_alarms(noise):
    scenario = load("ideal", [f"plant.sensor.noise_mps2={noise}", "latency_ticks=2"])
    found = unavoidable(scenario, np.full(1000, STEADY_NM))
    assert found is not None
    deviation = responses(scenario, STEADY_NM, 1000)
    evidence = np.cumsum(deviation**2) / (2.0 * noise**2)
    allowed = math.log(3600.0 / (1e-3 * scenario.budget.false_alarms_per_hour))
    ticks = int(np.argmax(evidence > allowed)) + 1
    assert found.detection_ticks == ticks > 5
    assert found.deviation_mps2 == pytest.approx(abs(deviation[ticks + 1]), rel=1e-9)


def test_more_noise_fewer_alarms_and_a_smaller_loss_take_longer():
    def ticks(*settings: str) -> int:
        scenario = load("ideal", ["plant.sensor.noise_mps2=0.005", *settings])
        found = unavoidable(scenario, np.full(2000, STEADY_NM))
        assert found is not None
        return found.detection_ticks

    usual = ticks()
    assert ticks("plant.sensor.noise_mps2=0.02") > usual
    assert ticks("budget.false_alarms_per_hour=1e-9") > usual
    assert ticks("fault.left=0.5") > usual
    assert ticks("plant.sensor.resolution_mps2=0.05") > usual


def test_coloured_noise_is_weighed_by_its_covariance():
    """δᵀ R⁻¹ δ / 2 with all of R, from long before the loss; no whitening filter."""
    noise, corner_hz, before = 0.005, 200.0, 100
    scenario = load(
        "ideal", [f"plant.sensor.noise_mps2={noise}", f"model.sensor.corner_hz={corner_hz}"]
    )
    found = unavoidable(scenario, np.full(1000, STEADY_NM))
    white = unavoidable(
        load("ideal", [f"plant.sensor.noise_mps2={noise}"]), np.full(1000, STEADY_NM)
    )
    assert found is not None
    assert white is not None
    colour = math.exp(-2.0 * math.pi * corner_hz * 1e-3)
    allowed = math.log(3600.0 / (1e-3 * scenario.budget.false_alarms_per_hour))
    evidence = 0.0
    ticks = 0
    while evidence <= allowed:
        ticks += 1
        signal = np.concatenate([np.zeros(before), responses(scenario, STEADY_NM, ticks)])
        covariance = noise**2 * toeplitz(colour ** np.arange(len(signal)))
        evidence = 0.5 * float(signal @ np.linalg.solve(covariance, signal))
    assert found.detection_ticks == ticks > white.detection_ticks


def test_a_dead_time_of_the_actuator_delays_the_loss_as_well():
    immediate, late = (
        unavoidable(
            load("ideal", [f"plant.torque_actuator.dead_time_s={dead_time_s}"]),
            np.full(50, STEADY_NM),
        )
        for dead_time_s in (0.0, 0.003)
    )
    assert immediate == late


def test_a_loss_that_does_nothing_never_shows():
    noisy = load("ideal", ["plant.sensor.noise_mps2=0.005"])
    assert unavoidable(noisy, np.zeros(1000)) is None
    assert unavoidable(noisy, np.full(3, STEADY_NM)) is None  # too short to decide
