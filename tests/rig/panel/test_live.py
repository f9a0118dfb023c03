"""What the panel does with frames of a listener that lags."""

from collections.abc import Iterable

import can
import numpy as np
import pytest

from can_rig.drawing.thinning import Decimator
from can_rig.frames import operator_frames
from can_rig.logs.columns import EVIDENCE
from can_rig.panel.live import COLUMNS, ENDS, HOLD, Frames, LiveSignals
from can_rig.results.isolation import with_verdict
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import FloatArray
from tests.helpers import load, record


def heard(scenario: Scenario, sent: Iterable[can.Message]) -> tuple[LiveSignals, FloatArray]:
    """What a panel has heard, and the rows that its page has got."""
    live = LiveSignals(scenario, network_of(scenario))
    for frame in sent:
        live.frames.on_message_received(frame)
    return live, np.concatenate([live.update() for _ in range(HOLD + 1)])


def _handed_over(frames: Frames, *stamps_s: float) -> list[float]:
    """Time stamps of what is ready after these frames have come."""
    for stamp_s in stamps_s:
        frames.on_message_received(can.Message(timestamp=stamp_s))
    return [message.timestamp for message in frames.in_order()]


def test_a_frame_waits_for_earlier_ones_of_a_listener_that_lags():
    frames = Frames(at_once=0x700)
    assert _handed_over(frames, 1.0, 3.0) == []
    assert [_handed_over(frames) for _ in range(HOLD - 2)] == [[]] * (HOLD - 2)
    assert _handed_over(frames, 2.0, 4.0) == []
    assert _handed_over(frames) == [1.0, 2.0, 3.0]


def test_every_frame_is_handed_over_when_no_more_come():
    frames = Frames(at_once=0x700)
    assert _handed_over(frames, 1.0, 2.0) == []
    assert [_handed_over(frames) for _ in range(HOLD)][-1] == [1.0, 2.0]
    assert _handed_over(frames, 3.0) == []


def test_no_tick_is_called_unanswered_because_the_listener_has_its_commands_late(tmp_path):
    log, _, scenario = record(tmp_path, "duration_s=0.1", name="ideal")
    network, sent = network_of(scenario), list(can.LogReader(log))
    commands = {getattr(network, role).frame_id for role in ENDS["controller"]}
    live = LiveSignals(scenario, network)
    for late in (False, True):
        for frame in sent:
            if (frame.arbitration_id in commands) is late:
                live.frames.on_message_received(frame)
        for _ in range(HOLD):
            live.update()
    live.update()
    assert live.lamps.unanswered_ticks == 0
    assert live.lamps.time_s > 0.09


def test_a_command_is_shown_with_the_time_from_which_it_acts(tmp_path):
    log, _, scenario = record(tmp_path, "duration_s=0.1", name="ideal")
    sent = list(can.LogReader(log))
    dead = operator_frames.Command("INJECT", "actuator-dead", "torque", 0.0)
    taken = operator_frames.taken_message(dead, 3)
    first = next(frame for frame in sent if frame.timestamp >= 50 * scenario.tick_s)
    taken.timestamp = first.timestamp
    undone = operator_frames.taken_message(dead._replace(value=2.0), 4)  # no share that is left
    sent[sent.index(first) : sent.index(first)] = [taken, undone]
    live, _ = heard(scenario, sent)
    assert live.taken_commands() == [(pytest.approx(50 * scenario.tick_s), dead)]
    assert live.taken_commands() == []


@pytest.mark.parametrize("not_heard", [0, 1, 3, 8, 13, 15])  # ticks: the screen's pairs differ
def test_a_change_of_the_state_has_the_time_of_its_tick(not_heard, tmp_path):
    log, _, scenario = record(tmp_path, "duration_s=0.3", "fault.at_s=0.2", name="ideal")
    signals = read_signals(log, network_of(scenario), scenario.tick_s)
    sent = [each for each in can.LogReader(log) if each.timestamp >= not_heard * scenario.tick_s]
    live, _ = heard(scenario, sent)
    at_s = {event.text: event.time_s for event in live.state_changes()}
    for text, codes, code in (
        ("fault state: confirmed", signals.fault_state, FaultState.CONFIRMED),
        ("whose fault: steering torque lost", signals.verdict, Verdict.TORQUE_LOST),
    ):
        assert at_s[text] == signals.time_s[codes == code][0]
    assert live.state_changes() == []
    after = [each for each in sent if each.timestamp >= 0.25]
    assert heard(scenario, after)[0].state_changes() == []  # confirmed since before, not now


def test_the_number_of_the_next_command_does_not_wait():
    """Else a second click would have the number of the first, and be refused."""
    scenario = load("ideal")
    live = LiveSignals(scenario, network_of(scenario))
    state = operator_frames.State(
        injectable=True, paused=False, next_sequence=7, last_checksum=1, refused=0, pace=1.0
    )
    live.frames.on_message_received(operator_frames.state_message(state, 0))
    live.update()
    assert live.state == state
    assert live.lamps.injectable


def _shown(scenario: Scenario, sent: list[can.Message]) -> dict[str, FloatArray]:
    """What the page gets of these frames, by column, a row a tick."""
    live = LiveSignals(scenario, network_of(scenario))
    live._decimator = Decimator(1, len(COLUMNS))
    for frame in sent:
        live.frames.on_message_received(frame)
    rows = np.concatenate([live.update() for _ in range(HOLD + 1)])
    return dict(zip(COLUMNS, rows.T, strict=True))


def test_the_evidence_is_that_of_the_run(tmp_path):
    """As ``signals.csv`` has it afterwards, to its last digit."""
    log, _, scenario = record(tmp_path, "duration_s=0.5", "fault.at_s=0.3", name="default")
    network = network_of(scenario)
    wanted = with_verdict(scenario, network, read_signals(log, network, scenario.tick_s))
    shown = _shown(scenario, list(can.LogReader(log)))
    assert shown["evidence_torque_lost"].max() > 30.0
    for name in EVIDENCE:
        rows = len(shown[name])
        assert rows >= 498
        np.testing.assert_allclose(shown[name], wanted.whose_fault[name][:rows], atol=6e-4)


@pytest.mark.parametrize("heard", ["from the middle on", "with other commands"])
def test_evidence_of_what_was_not_heard_is_unknown(heard, tmp_path):
    log, _, scenario = record(tmp_path, "duration_s=0.1", name="default")
    other, _, _ = record(tmp_path, "duration_s=0.1", "seed=5", name="default")
    sent = list(can.LogReader(log))
    torque = network_of(scenario).command_1.frame_id
    if heard == "with other commands":
        others = [each for each in can.LogReader(other) if each.arbitration_id == torque]
        sent = [
            others[i // 5] if frame.arbitration_id == torque else frame
            for i, frame in enumerate(sent)
        ]
    else:
        sent = sent[len(sent) // 2 :]
    shown = _shown(scenario, sent)["evidence_torque_lost"]
    assert np.isnan(shown[10:]).all()
    assert len(shown) > 40


def test_the_last_value_of_each_further_sensor_is_shown_and_one_that_is_not_valid(tmp_path):
    fault = ["fault.kind=sensor-invalid", "fault.channel=torque-echo", "fault.at_s=0.05"]
    log, _, scenario = record(tmp_path, "duration_s=0.1", *fault, name="cluster")
    live, _ = heard(scenario, can.LogReader(log))
    said = read_signals(log, network_of(scenario), scenario.tick_s).sensors
    last = {name: column[np.isfinite(column)][-1] for name, column in said.items()}
    assert live.lamps.sensors == {
        "yaw rate rad/s": last["measured_yaw_rate_rad_per_s"],
        "lateral acceleration m/s²": last["measured_lateral_acceleration_mps2"],
        "steering angle rad": last["measured_steering_angle_rad"],
        "torque echo N m": None,
        "force difference echo N": last["force_difference_echo_n"],
    }


@pytest.mark.parametrize("kind", ["pi", "kalman"])
def test_the_screen_is_empty_where_a_controller_says_nothing(kind, tmp_path):
    settings = ["duration_s=0.3", "fault.at_s=0.1", f"controller.kind={kind}"]
    log, _, scenario = record(tmp_path, *settings, name="default")
    live, rows = heard(scenario, can.LogReader(log))
    shown = dict(zip(COLUMNS, rows.T, strict=True))
    says = kind == "kalman"
    assert np.isfinite(shown["estimate"]).any() == np.isfinite(shown["fault_state"]).any() == says
    assert not np.isfinite([shown[name] for name in ("verdict", *EVIDENCE)]).any()
    assert (live.lamps.mode, live.lamps.verdict, live.confirm) == ("RUN", "", None)
    assert live.lamps.fault_state == ("CONFIRMED" if says else "")
