"""Whose fault it is, in runs: the verdict, its time, and undisturbed signals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from can_rig.drawing.names import CAR
from can_rig.logs.columns import EVIDENCE, VERDICT
from can_rig.plant.frameless import frameless
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.isolation import CERTAIN, in_words, verdict_rows, whose_fault, with_verdict
from can_rig.results.metrics import metrics_of
from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.discretisation.schedules import Scheduled
from firmware_model.law.status import FaultState, Mode, Verdict
from tests.helpers import on_no_bus

LANE_CHANGE = ["reference.kind=lane-change", "reference.frequency_rad_per_s=1.34", "duration_s=5"]
BOTH_LOST = ["fault.0.kind=actuator-dead", "fault.0.at_s=3.5", "fault.1.kind=actuator-dead",
             "fault.1.channel=force-difference", "fault.1.at_s=4.4"]  # fmt: skip
SENSOR = (Verdict.SENSOR_WRONG, Verdict.SENSOR_DRIFTING, Verdict.SENSOR_FROZEN)


def run(name: str, changes: Sequence[str]) -> tuple[Scenario, Signals]:
    scenario = load(name, list(changes))
    signals = with_verdict(scenario, network_of(scenario), signals_without_log(scenario))
    return scenario, signals


def verdicts(signals: Signals, begin_s: float = 0.0, end_s: float = 99.0) -> set[Verdict]:
    inside = (signals.time_s >= begin_s) & (signals.time_s < end_s)
    return {Verdict(int(code)) for code in set(signals.whose_fault[VERDICT][inside])}


@pytest.mark.parametrize(
    ("fault", "within_s", "verdict"),
    [
        (["kind=sensor-biased", "bias_mps2=0.1"], 0.002, Verdict.SENSOR_WRONG),
        (["kind=sensor-biased", "bias_mps2=-0.1"], 0.002, Verdict.SENSOR_WRONG),
        (["kind=sensor-stuck"], 0.02, Verdict.SENSOR_FROZEN),
        (["kind=actuator-dead"], 0.12, Verdict.TORQUE_LOST),
        (["kind=actuator-dead", "left=0.5"], 0.2, Verdict.TORQUE_LOST),
    ],
)
def test_a_fault_in_a_lane_change_is_named(fault, within_s, verdict):
    changes = [*LANE_CHANGE, "fault.at_s=3.5", *(f"fault.{key}" for key in fault)]
    scenario, signals = run("default", changes)
    assert verdicts(signals, 0.0, 3.5) == {Verdict.NOTHING}
    found = whose_fault(scenario, signals)[verdict.name]
    assert 3.5 <= found["since_s"] <= 3.5 + within_s
    assert Verdict.BOTH_LOST not in verdicts(signals)


def test_the_loss_of_both_channels_is_named_and_that_of_one_is_not_taken_for_it():
    scenario, signals = run("default", [*LANE_CHANGE, *BOTH_LOST])
    assert Verdict.BOTH_LOST not in verdicts(signals, 0.0, 4.4)
    found = whose_fault(scenario, signals)
    assert 4.4 < found["BOTH_LOST"]["since_s"] < 5.0
    assert len(found["BOTH_LOST"]["evidence"]) == len(EVIDENCE)


def test_with_both_lost_a_safe_stop_takes_the_commands_back():
    """As soon as the car does not follow commands that ask for much."""
    _, signals = run("default", [*LANE_CHANGE, *BOTH_LOST, "duration_s=6.5"])
    stopped = signals.mode == Mode.SAFE_STOP
    since_s = signals.time_s[np.argmax(stopped)]
    assert 4.7 < since_s < 5.2
    assert (signals.verdict[stopped] == Verdict.BOTH_LOST).all()
    np.testing.assert_array_equal(stopped, signals.time_s >= since_s)
    asked = np.abs(signals.reference_mps2 - signals.dstar_mps2)
    assert asked[(signals.time_s > since_s - 0.3) & (signals.time_s < since_s)].min() > 0.35
    for command in (signals.torque_nm, signals.force_difference_n):
        begin = command[~stopped][-1]
        assert np.abs(np.diff([begin, *command[stopped]])).max() < 1.5 / 200 * abs(begin) + 1.0
        assert not command[signals.time_s > since_s + 0.202].any()


@pytest.mark.parametrize(
    "fault",
    [["kind=sensor-biased", "bias_mps2=0.1"], ["kind=sensor-biased", "bias_mps2=-0.1"],
     ["kind=sensor-stuck"], ["kind=sensor-dead"]],
)  # fmt: skip
def test_a_sensor_that_is_found_at_fault_is_not_compensated(fault):
    """The deviation is that of a run without compensation."""
    deviations = []
    for compensation in ("on-confirmation", "off"):
        changes = [*LANE_CHANGE, "fault.at_s=3.5", *(f"fault.{key}" for key in fault)]
        scenario = load("default", [*changes, f"design.compensation={compensation}"])
        values = metrics_of(scenario)
        deviations.append(values["deviation_peak_after_fault_mps2"])
        assert compensation == "off" or values["false_alarms"] == 0
    with_it, without = deviations
    assert with_it is not None and without is not None
    assert with_it == pytest.approx(without, rel=1e-3)
    assert with_it < 1.0


@pytest.mark.parametrize(
    ("name", "changes"),
    [*(("thesis-step", ["tick_s=0.0001", f"plant.variant={v}"]) for v in ("physics", "published")),
     ("thesis-step", []), ("ideal", []), ("default", ["design.compensation=always"]),
     ("chassis-can", ["design.compensation=always", "design.tau_s=0.03"])],
)  # fmt: skip
@pytest.mark.parametrize("kind", ["step", "sine", "lane-change"])
def test_no_verdict_takes_away_what_compensates_a_lost_torque(name, changes, kind):
    """D* is that of the same law with verdicts that are never sure of any place."""
    draw = np.random.default_rng(len(kind))
    for _ in range(2):
        amplitude, frequency = np.exp(draw.uniform(np.log([0.1, 0.5]), np.log([3.0, 20.0])))
        at_s = round(draw.uniform(0.2, 2.0), 2)
        moving = [] if kind == "step" else [f"reference.frequency_rad_per_s={frequency}"]
        scenario = load(
            name,
            [*changes, *moving, f"reference.kind={kind}", f"reference.amplitude_mps2={amplitude}",
             f"fault.at_s={at_s}", f"duration_s={at_s + 0.4}"],
        )  # fmt: skip
        network = network_of(scenario)
        of = controls(scenario, network)
        unsure = of.table.copy()
        unsure["hypotheses"]["ahead"] = unsure["hypotheses"]["sensor_ahead"] = np.inf
        law, without = (frameless(scenario, Scheduled(None, table)) for table in (of.table, unsure))
        assert Verdict.FORCE_LOST not in law.verdict
        np.testing.assert_array_equal(law.measurement, without.measurement)


@pytest.mark.parametrize("noise", ["0", "1e-5", "1e-3"])
def test_a_finer_sensor_finds_a_dead_motor_at_least_as_soon(noise):
    settings = ["fault.at_s=1", "duration_s=2"]
    usual, fine = (
        metrics_of(load("default", [*settings, f"plant.sensor.noise_mps2={each}"]))
        for each in ("0.005", noise)
    )
    assert 0.0 < fine["detection_delay_s"] <= usual["detection_delay_s"]


def test_a_motor_that_dies_beside_a_biased_sensor_is_found_as_soon_as_alone():
    dead = ["fault.0.kind=actuator-dead", "fault.0.at_s=4"]
    biased = ["fault.1.kind=sensor-biased", "fault.1.bias_mps2=0.1", "fault.1.at_s=3"]
    delays = [
        metrics_of(load("default", [*LANE_CHANGE, *faults]))["detection_delay_s"]
        for faults in (dead, [*dead, *biased])
    ]
    assert delays[0] is not None
    assert delays[1] == pytest.approx(delays[0], abs=0.01)


@pytest.mark.parametrize("name", ["default", "noisy", "chassis-can"])
@pytest.mark.parametrize("seed", range(3))
def test_a_lost_motor_is_never_the_fault_of_the_sensor(name, seed):
    """Nor is a healthy car's."""
    changes = ["duration_s=3", "fault.at_s=2", f"seed={seed}"]
    _, signals = run(name, changes)
    assert verdicts(signals, 0.0, 2.0) == {Verdict.NOTHING}
    assert not verdicts(signals) & {*SENSOR, Verdict.BOTH_LOST}
    last = signals.whose_fault[VERDICT][-1], signals.fault_state[-1]
    assert last == (Verdict.TORQUE_LOST, FaultState.CONFIRMED)


@pytest.mark.parametrize(("for_s", "end_s"), [(3.0, 6.0), (9.0, 12.0)])
def test_a_lost_force_difference_is_named_until_its_use_shows_that_it_works(for_s, end_s):
    changes = ["design.compensation=always", "fault.channel=force-difference", "fault.at_s=3",
               f"fault.for_s={for_s}", "duration_s=12", "seed=1"]  # fmt: skip
    _, signals = run("noisy", changes)
    assert verdicts(signals, 3.2, end_s) == {Verdict.FORCE_LOST}
    assert Verdict.FORCE_LOST not in verdicts(signals, end_s + 1.0)


def test_the_verdict_waits_while_inputs_are_missing():
    scenario, signals = run("default", ["duration_s=0.3", "fault.kind=none"])
    measured = signals.dstar_mps2.copy()
    measured[100:110] = np.nan
    found = with_verdict(scenario, network_of(scenario), replace(signals, dstar_mps2=measured))
    held = np.array([found.whose_fault[name][99:110] for name in EVIDENCE])
    assert (held == held[:, :1]).all()
    assert held.any()


def test_what_is_said_of_a_run():
    scenario, signals = run("default", ["duration_s=0.2", "fault.kind=none"])
    assert whose_fault(scenario, signals) == {}
    assert verdict_rows(scenario, {}) == []
    found = {name: {"since_s": 3.5, "for_s": for_s} for name, for_s in
             (("CANNOT_BE_TOLD", 0.1), ("FORCE_LOST", 2.0))}  # fmt: skip
    assert verdict_rows(scenario, found) == [
        ("whose fault", "rear force difference lost, from 3.5 s")
    ]
    words = {in_words(verdict, CAR) for verdict in Verdict}
    assert len(words) == len(Verdict)
    assert not any("{" in each for each in words)


def test_the_status_frame_says_the_verdict(tmp_path):
    """As the law itself says it, and what the frame says counts."""
    faults = ["fault.kind=sensor-biased", "fault.at_s=0.2", "duration_s=0.3"]
    scenario = load("default", faults)
    network, log = network_of(scenario), tmp_path / "bus.log"
    on_no_bus(scenario, log)
    heard = read_signals(log, network, scenario.tick_s)
    assert heard.verdict is not None
    again = with_verdict(scenario, network, replace(heard, verdict=None))
    assert heard.verdict.tolist() == again.whose_fault[VERDICT].tolist()
    assert heard.verdict[-1] == Verdict.SENSOR_WRONG
    heard.verdict[:] = Verdict.FORCE_LOST
    assert verdicts(with_verdict(scenario, network, heard)) == {Verdict.FORCE_LOST}


@pytest.mark.parametrize("survives", ["false", "true"])
def test_after_a_restart_the_law_says_the_verdict_of_the_status_frame_again(survives):
    restart = ["kind=controller-restarted", "at_s=9.9", "for_s=0.5", f"state_survives={survives}"]
    scenario = load("default", ["duration_s=12", *(f"fault.1.{key}" for key in restart)])
    signals = signals_without_log(scenario)
    again = with_verdict(scenario, network_of(scenario), replace(signals, verdict=None))
    heard = np.isfinite(signals.verdict)
    np.testing.assert_array_equal(again.whose_fault[VERDICT][heard], signals.verdict[heard])


def test_evidence_without_noise_is_finite():
    """At rest and without noise every tick of a bias is beyond doubt; run.json has no infinity."""
    rest = ["reference.amplitude_mps2=0", "plant.sensor.noise_mps2=0", "duration_s=2"]
    rest.append("budget.disturbance_mps2=0")
    fault = ["fault.kind=sensor-biased", "fault.at_s=0.5"]
    scenario, signals = run("default", [*rest, *fault])
    largest = max(float(np.abs(signals.whose_fault[name]).max()) for name in EVIDENCE)
    assert 1e9 < largest <= CERTAIN
    for found in whose_fault(scenario, signals).values():
        assert np.isfinite(list(found["evidence"].values())).all()
