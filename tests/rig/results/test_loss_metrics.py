"""What the decision on the fault estimate made of a loss, and what nothing could avoid."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from can_rig.api import load_scenario
from can_rig.results import metrics as module
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.metrics import fault_metrics, metrics
from can_rig.results.signals import Signals
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.design.plants import steer_by_wire
from firmware_model.law.status import Verdict
from tests.rig.results.quiet import quiet

CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = 0.0, 1.0, 2.0, 3.0


def states(scenario: Scenario, *changes: tuple[int, float]) -> np.ndarray:
    """The fault state of every tick: CLEAR, then the state of each named tick from that tick on."""
    state = np.full(scenario.ticks, CLEAR)
    for tick, value in changes:
        state[tick:] = value
    return state


def acting(scenario: Scenario, *changes: tuple[int, float], **columns: np.ndarray) -> Signals:
    """A run at rest but for a steady torque, with these fault states."""
    columns["torque_nm"] = np.full(scenario.ticks, 40.0)
    return quiet(scenario, fault_state=states(scenario, *changes), **columns)


def test_the_decision_is_what_the_status_frames_say():
    scenario = load("thesis-step", ["duration_s=3.6", "fault.at_s=1.0", "fault.for_s=1.0"])
    signals = acting(
        scenario,
        (100, CONFIRMED),  # a false alarm before the loss detects nothing
        (200, CLEAR),
        (300, SUSPECTED),  # is none
        (301, CLEAR),
        (1100, SUSPECTED),
        (1234, CONFIRMED),  # stays so after the channel has come back: no other alarm
        (2500, CLEAR),
        (2600, CONFIRMED),  # another one
    )
    values = metrics(scenario, signals)
    assert values["suspected_after_s"] == 0.1
    assert values["detection_delay_s"] == 0.234
    assert values["missed_detection"] is False
    assert values["false_alarms"] == 2
    assert values["suspicions"] == 3
    assert values["false_alarms_per_hour"] == pytest.approx(2 * 3600.0 / 2.6)
    assert values["torque_healthy_s"] == 2.6


@pytest.mark.parametrize(
    ("changes", "delay_s", "missed", "alarms"),
    [
        ([(900, CONFIRMED)], None, True, 1),
        ([(900, CONFIRMED), (1400, np.nan), (1410, CONFIRMED)], None, True, 1),  # frames lost
        ([(900, CONFIRMED), (1400, CLEAR), (1450, CONFIRMED)], 0.45, False, 1),
        ([(900, CONFIRMED), (1400, np.nan), (1410, CLEAR), (1450, CONFIRMED)], 0.45, False, 1),
        ([(1000, CONFIRMED)], None, True, 1),  # from a sample that was taken before the loss
        ([(1001, CONFIRMED)], 0.001, False, 0),
        ([(1050, CONFIRMED), (1500, CLEAR)], None, True, 0),  # not known at the end of the loss
        ([(1050, CONFIRMED), (1500, CLEAR), (1600, CONFIRMED)], 0.05, False, 0),
        ([(900, SUSPECTED), (1050, CONFIRMED)], 0.05, False, 0),
        ([(900, SUSPECTED)], None, True, 0),
        ([(2000, CONFIRMED)], 1.0, False, 0),  # from the last sample of the loss
        ([(2001, CONFIRMED)], None, True, 1),
    ],
)
def test_only_a_confirmation_that_begins_in_the_loss_and_stands_finds_it(
    changes, delay_s, missed, alarms
):
    scenario = load("thesis-step", ["duration_s=2.5", "fault.at_s=1.0", "fault.for_s=1.0"])
    signals = acting(scenario, *changes)
    values, (of_fault,) = metrics(scenario, signals), fault_metrics(scenario, signals)
    assert values["detection_delay_s"] == of_fault["detection_delay_s"] == delay_s
    assert values["missed_detection"] is of_fault["missed_detection"] is missed
    assert values["false_alarms"] == alarms
    assert delay_s is None or values["suspected_after_s"] == delay_s


@pytest.mark.parametrize(
    ("settings", "told", "first"),
    [
        ([], 0, 1001),
        (["plant.sensor.dead_time_s=0.0025"], 0, 1003),
        ([], 1200, 1201),  # at rest nothing is lost
        (["latency_ticks=3"], 1200, 1204),
        (["latency_ticks=3"], 997, 1001),
    ],
)
def test_no_confirmation_is_of_a_loss_that_no_sample_shows(settings, told, first):
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0", *settings])
    torque = np.where(np.arange(scenario.ticks) < told, 0.0, 40.0)
    for tick in (first - 1, first):
        state = states(scenario, (tick, CONFIRMED))
        values = metrics(scenario, quiet(scenario, torque_nm=torque, fault_state=state))
        assert values["false_alarms"] == (tick < first)
        assert values["missed_detection"] is (tick < first)
        delay_s = None if tick < first else round((tick - 1000) * 1e-3, 9)
        assert values["detection_delay_s"] == delay_s


def test_a_delay_below_a_tick_is_refused_and_names_the_run(monkeypatch):
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0003", "seed=7"])
    signals = acting(scenario, (1001, CONFIRMED))
    assert metrics(scenario, signals)["missed_detection"] is True
    monkeypatch.setattr(module, "_shown", module._there)
    named = r"thesis-step, seed 7: the loss at 1.0003 s is said to be found after 0.0007 s"
    with pytest.raises(AssertionError, match=named):
        metrics(scenario, signals)


def test_a_verdict_on_another_place_finds_nothing():
    """The torque is lost; its confirmation counts from the tick that names no other place."""
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0"])
    for verdict, delay_s in (
        (Verdict.FORCE_LOST, 0.3), (Verdict.SENSOR_WRONG, 0.3), (Verdict.SENSOR_DRIFTING, 0.3),
        (Verdict.SENSOR_FROZEN, 0.3), (Verdict.TORQUE_LOST, 0.1), (Verdict.BOTH_LOST, 0.1),
        (Verdict.CANNOT_BE_TOLD, 0.1),
    ):  # fmt: skip
        verdicts = states(scenario, (1100, verdict), (1300, Verdict.TORQUE_LOST))
        values = metrics(scenario, acting(scenario, (1100, CONFIRMED), verdict=verdicts))
        assert values["detection_delay_s"] == delay_s
        verdicts[1300:] = verdict
        values = metrics(scenario, acting(scenario, (1100, CONFIRMED), verdict=verdicts))
        assert values["missed_detection"] is (delay_s == 0.3)


def test_a_lost_force_difference_is_found_by_its_own_verdict_alone():
    lost = ["fault.channel=force-difference", "fault.at_s=1.0"]
    scenario = load("thesis-step", ["duration_s=2.0", *lost])
    force = np.full(scenario.ticks, 500.0)
    for verdict, delay_s in (
        (Verdict.FORCE_LOST, 0.1), (Verdict.BOTH_LOST, 0.1), (Verdict.TORQUE_LOST, None),
        (Verdict.SENSOR_WRONG, None), (Verdict.CANNOT_BE_TOLD, None), (None, None),
    ):  # fmt: skip
        verdicts = None if verdict is None else states(scenario, (1100, verdict))
        signals = acting(scenario, (1100, CONFIRMED), force_difference_n=force, verdict=verdicts)
        values = metrics(scenario, signals)
        assert values["detection_delay_s"] == delay_s
        assert values["missed_detection"] is (delay_s is None)
        assert values["false_alarms"] == 1  # of the torque, which works


def test_a_standing_false_alarm_finds_a_loss_only_where_it_compensates():
    """A car that the decision does not allow for: a false alarm, and then the motor dies."""
    car = ["plant.mass_kg=1300", "model.mass_kg=1400", "budget.box=0", "budget.actuator_box=0"]
    settings = ["duration_s=6", "fault.at_s=4.0003", "budget.disturbance_mps2=0", *car]
    missed = {}
    for compensation in ("on-confirmation", "off"):
        scenario = load("default", [*settings, f"design.compensation={compensation}"])
        signals = signals_without_log(scenario)
        values = metrics(scenario, signals)
        assert values["false_alarms"] == 1
        assert (signals.fault_state[4000:] == CONFIRMED).all()
        assert values["detection_delay_s"] is None
        missed[compensation] = (values["missed_detection"], signals.error_mps2[-1])
    assert missed["on-confirmation"] == (False, pytest.approx(0.0, abs=0.05))
    assert missed["off"] == (True, pytest.approx(1.0, abs=0.05))


def test_a_loss_that_an_echo_tells_without_a_confirmation_is_missed_only_uncompensated():
    """Half of the torque is lost while the reference sweeps from 0.1 to 0.8 Hz."""
    time_s = np.arange(0.0, 7.0, 0.001)
    sweep = np.sin(2.0 * np.pi * (0.1 * time_s + 0.0483 * time_s**2))
    missed = {}
    for compensation in ("on-confirmation", "off"):
        scenario = load_scenario("cluster", {
            "duration_s": 7, "fault.at_s": 5, "fault.left": 0.5,
            "reference.kind": "samples", "reference.samples_mps2": sweep,
            "design.compensation": compensation,
        })  # fmt: skip
        signals = signals_without_log(scenario)
        assert signals.verdict[-1] == Verdict.TORQUE_LOST
        assert signals.fault_state[-1] != CONFIRMED
        values = metrics(scenario, signals)
        assert values["detection_delay_s"] is None
        missed[compensation] = values["missed_detection"]
    assert missed == {"on-confirmation": False, "off": True}


def test_of_two_losses_the_one_that_is_missed_decides_and_the_longest_delay():
    second = ["fault.1.kind=actuator-dead", "fault.1.channel=force-difference", "fault.1.at_s=1.5"]
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0", *second])
    force = np.full(scenario.ticks, 500.0)
    for begins, of_faults, of_run in (
        ((1200, 1650), ((0.2, False), (0.15, False)), (0.2, False)),
        ((1200, 1800), ((0.2, False), (0.3, False)), (0.3, False)),
        ((1200, 9999), ((0.2, False), (None, True)), (None, True)),
        ((9999, 1650), ((None, True), (0.15, False)), (None, True)),
        ((1200, 1400), ((0.2, False), (None, True)), (None, True)),
    ):
        verdict = states(scenario, (begins[1], Verdict.BOTH_LOST))
        signals = acting(
            scenario, (begins[0], CONFIRMED), force_difference_n=force, verdict=verdict
        )
        keys = ("detection_delay_s", "missed_detection")
        found = [tuple(each[key] for key in keys) for each in fault_metrics(scenario, signals)]
        values = metrics(scenario, signals)
        assert (tuple(found), tuple(values[key] for key in keys)) == (of_faults, of_run)


def test_a_channel_that_is_known_to_be_lost_is_not_lost_again():
    second = ["fault.1.kind=frames-missing", "fault.1.channel=torque", "fault.1.at_s=1.5"]
    settings = ["duration_s=2.0", "fault.at_s=1.0", *second]
    for for_s, missed in ((0.7, None), (0.3, True)):  # over before, and never seen to be over
        scenario = load("thesis-step", [*settings, f"fault.0.for_s={for_s}"])
        first, second_one = fault_metrics(scenario, acting(scenario, (1200, CONFIRMED)))
        assert (first["detection_delay_s"], first["missed_detection"]) == (0.2, False)
        assert second_one["detection_delay_s"] is None
        assert second_one["missed_detection"] is missed


def test_of_two_faults_that_begin_together_the_one_that_shows_first_is_found():
    """A dead motor shows with its first command; missing frames have told of the loss before."""
    first = ["fault.kind=frames-missing", "fault.at_s=1.0"]
    second = ["fault.1.kind=actuator-dead", "fault.1.channel=torque", "fault.1.at_s=1.0"]
    scenario = load("thesis-step", ["duration_s=2.0", *first, *second])
    torque = np.where(np.arange(scenario.ticks) < 1200, 0.0, 40.0)
    state = states(scenario, (1100, CONFIRMED))
    frames, motor = fault_metrics(scenario, quiet(scenario, torque_nm=torque, fault_state=state))
    assert (frames["detection_delay_s"], frames["missed_detection"]) == (0.1, False)
    assert (motor["detection_delay_s"], motor["missed_detection"]) == (None, None)


@pytest.mark.parametrize("state", [CLEAR, SUSPECTED, CANNOT_TELL])
def test_a_part_of_the_torque_is_missed_by_the_same_rule_as_all_of_it(state):
    """The same torque that is missing, as half of what is asked for, a tenth, or all."""
    missed = {}
    for missing_nm in (1e-6, 0.01, 0.1, 1.0, 10.0):
        for left in (0.0, 0.5, 0.9):
            scenario = load("default", ["duration_s=2", "fault.at_s=1", f"fault.left={left}"])
            torque = np.full(scenario.ticks, missing_nm / (1.0 - left))
            signals = quiet(scenario, torque_nm=torque, fault_state=states(scenario, (0, state)))
            values = metrics(scenario, signals)
            assert values["detection_delay_s"] is None
            missed.setdefault(missing_nm, set()).add(values["missed_detection"])
    expected = {1e-6: {None}, 0.01: {None}, 0.1: {True}, 1.0: {True}, 10.0: {True}}
    assert missed == expected


def test_a_torque_whose_frames_are_missing_is_missed_where_the_car_shows_it():
    """Whatever the controller says of what it can tell."""
    for channel, missed in (("torque", True), ("force-difference", None)):
        settings = ["fault.kind=frames-missing", f"fault.channel={channel}", "fault.at_s=1.5"]
        scenario = load("thesis-step", [*settings, "duration_s=3.0", "design.compensation=off"])
        signals = signals_without_log(scenario)
        for state in (CLEAR, CANNOT_TELL):
            said = replace(signals, fault_state=states(scenario, (0, state)))
            assert metrics(scenario, said)["missed_detection"] is missed


def test_nothing_is_missed_where_nothing_is_lost():
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0"])
    nothing_lost = metrics(scenario.healthy, quiet(scenario))
    assert nothing_lost["missed_detection"] is None
    assert nothing_lost["false_alarms_per_hour"] == 0.0


def test_there_is_a_bound_where_the_log_has_every_command_that_is_lost():
    for at_s, latency, there in (
        (0.002, 2, True), (0.001, 2, False), (0.0, 0, True), (0.0191, 0, False), (0.019, 0, True),
    ):  # fmt: skip
        settings = ["duration_s=0.02", f"fault.at_s={at_s}", f"latency_ticks={latency}"]
        scenario = load("ideal", settings)
        signals = quiet(scenario, torque_nm=np.full(scenario.ticks, 1e6))
        assert (metrics(scenario, signals)["unavoidable_deviation_mps2"] is not None) == there


@pytest.mark.parametrize(("for_s", "noise", "told"), [(0.005, 1e-3, True), (0.005, 0.1, False)])
def test_a_loss_that_ends_does_no_more_and_may_never_be_told(for_s, noise, told):
    """A pulse of missing torque: scipy's step response of G1, and the same after its end."""
    settings = [f"fault.for_s={for_s}", "fault.at_s=1", f"plant.sensor.noise_mps2={noise}"]
    scenario = load("ideal", [*settings, "duration_s=3"])
    torque = 40.0
    values = metrics(scenario, quiet(scenario, torque_nm=np.full(scenario.ticks, torque)))
    g1 = steer_by_wire().g1
    times = np.arange(1, 2000) * scenario.tick_s
    plant = signal.ZerosPolesGain(g1.zeros, g1.poles, g1.gain)
    missing = torque * np.where(np.arange(2000) * scenario.tick_s < for_s - 1e-9, 1.0, 0.0)
    one = signal.step(plant, T=np.append(0.0, times))[1]
    pulse = np.abs(np.convolve(np.diff(missing, prepend=0.0), one)[1:2000])
    evidence = np.cumsum(pulse**2) / (2.0 * noise**2)
    if not told:
        assert evidence[-1] < np.log(3600.0 / scenario.tick_s / 1e-3)
        assert values["unavoidable_deviation_mps2"] is values["missed_detection"] is None
        return
    found = int(np.argmax(evidence > np.log(3600.0 / scenario.tick_s / 1e-3)))
    assert values["unavoidable_detection_delay_s"] == pytest.approx(times[found])
    expected = pulse[: found + 1 + scenario.latency_ticks].max()
    assert values["unavoidable_deviation_mps2"] == pytest.approx(expected, rel=1e-4)
    assert found * scenario.tick_s > for_s  # later than its end


def test_there_is_nothing_unavoidable_where_no_actuator_dies_in_the_log():
    for settings in (["fault.kind=none"], ["fault.kind=frames-missing"], ["duration_s=2.0"]):
        scenario = load("thesis-step", ["tick_s=0.01", *settings])
        assert metrics(scenario, quiet(scenario))["unavoidable_deviation_mps2"] is None
