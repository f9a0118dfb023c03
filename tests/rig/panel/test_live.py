"""What the panel does with frames of a listener that lags."""

from __future__ import annotations

import can
import pytest

from can_rig.frames.beside import control
from can_rig.panel.live import ENDS, HOLD, Frames, LiveSignals
from can_rig.scenario.build import network_of
from tests.helpers import load, record


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
    network, sent = network_of(scenario), list(can.LogReader(log))
    dead = control.Command("INJECT", "actuator-dead", "torque", 0.0)
    taken = control.taken_message(dead, 3)
    first = next(frame for frame in sent if frame.timestamp >= 50 * scenario.tick_s)
    taken.timestamp = first.timestamp
    undone = control.taken_message(dead._replace(value=2.0), 4)  # no share that is left
    sent[sent.index(first) : sent.index(first)] = [taken, undone]
    live = LiveSignals(scenario, network)
    for frame in sent:
        live.frames.on_message_received(frame)
    for _ in range(HOLD + 1):
        live.update()
    assert live.taken_commands() == [(pytest.approx(50 * scenario.tick_s), dead)]
    assert live.taken_commands() == []


def test_the_number_of_the_next_command_does_not_wait():
    """Else a second click would have the number of the first, and be refused."""
    scenario = load("ideal")
    live = LiveSignals(scenario, network_of(scenario))
    state = control.State(
        injectable=True, paused=False, next_sequence=7, last_checksum=1, refused=0, pace=1.0
    )
    live.frames.on_message_received(control.state_message(state, 0))
    live.update()
    assert live.state == state
    assert live.lamps.injectable
