"""Every defect of a log is named, and no other defect."""

from collections import Counter
from copy import deepcopy

import pytest
from can import Message
from hypothesis import given, settings, strategies as st

from can_rig.frames.codec import Transmitter
from firmware_model.law.status import Mode
from tests.helpers import NAMES
from tests.rig.replay.drive import (
    ALL,
    NETWORK,
    SCENARIO,
    TICKS,
    answers,
    listed,
    logged,
    mangled,
    replay,
)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 700))
def test_dropped_doubled_and_swapped_frames_are_all_listed_and_nothing_else(frames, seed, chunk):
    log, wrong = mangled(frames, seed)
    loop, gaps = replay(log, chunk=chunk)
    assert listed(gaps) == wrong
    comparison = loop.comparison
    missing = {key for key in wrong if key[2] == "missing"}
    deaf = {tick for tick, name, _ in missing if name in NAMES[:2]}
    assert comparison.ticks == TICKS
    assert comparison.without_input == len(deaf)
    for role in (2, 3, 4):
        number = sum(name == NAMES[role] and tick not in deaf for tick, name, _ in missing)
        assert comparison.without_answer[NAMES[role]] == number
    harmful = {
        tick
        for tick, name, what in wrong
        if name in NAMES[:2] and what != "repeated" and (name, what) != (NAMES[1], "out of order")
    }
    assert loop.account.first_input_gap == (min(harmful) if harmful else None)
    first = comparison.first_different_tick
    assert first is None or first >= min(harmful)


@pytest.mark.parametrize("role", [0, 1])
def test_a_tick_without_an_input_is_held_and_the_next_goes_on(frames, role):
    deaf = {50, 51, 52, 300}
    log = [f for at, f in enumerate(frames) if not (at % ALL == role and at // ALL in deaf)]
    loop, gaps = replay(log)
    assert listed(gaps) == Counter({(tick, NAMES[role], "missing"): 1 for tick in deaf})
    expected, theirs = answers(frames, SCENARIO, deaf), logged(frames)
    assert all(expected[tick][3] == Mode.BLIND for tick in deaf)
    for at, signal in enumerate(loop.comparison.signals):
        apart = [
            tick
            for tick in range(TICKS)
            if tick not in deaf and expected[tick][at] != theirs[tick][at]
        ]
        assert signal.different == len(apart)
        assert (signal.first.tick if signal.first else None) == (apart[0] if apart else None)
        assert signal.compared == TICKS - len(deaf)


def test_a_hole_in_the_log_is_no_clock_step(frames):
    loop, gaps = replay(frames[: ALL * 100] + frames[ALL * 300 :])
    assert sorted(gap[:1] + gap[2:5] for gap in gaps) == sorted(
        (100, name, "missing", 200) for name in NAMES
    )
    assert loop.comparison.ticks == TICKS
    assert loop.comparison.without_input == 200


def test_answers_lost_on_the_way_to_the_recorder_do_not_fail_silently(frames):
    log = [f for at, f in enumerate(frames) if not (at % ALL == 2 and 100 <= at // ALL < 350)]
    loop, gaps = replay(log)
    assert loop.comparison.identical
    assert loop.comparison.compared == TICKS - 250
    assert loop.comparison.without_answer[NAMES[2]] == 250
    assert (loop.account.first_input_gap, loop.account.first_answer_gap) == (None, 100)
    assert loop.comparison.signals[0].compared == TICKS - 250
    (gap,) = gaps
    assert gap[:1] + gap[2:5] == (100, NAMES[2], "missing", 250)


def test_a_frame_made_up_does_not_move_time(frames):
    sender = Transmitter(NETWORK.feedback)
    for wire_tick in (120, 5000, 40_000):
        stray = sender.frame(1.0, wire_tick)
        stray.timestamp = frames[ALL * 100].timestamp
        loop, gaps = replay([*frames[: ALL * 100], stray, stray, *frames[ALL * 100 :]])
        assert loop.comparison.identical
        assert loop.comparison.compared == TICKS
        assert loop.rejected()[NAMES[1]] == {"wrong_tick": 2}
        assert [(gap.tick, gap.what, gap.detail) for gap in gaps] == [
            (100, "stray tick", f"the frame says {wire_tick}")
        ] * 2


def test_damage_is_named(frames):
    log = deepcopy(frames)
    log[ALL * 20 + 2].data[5] ^= 4
    log[ALL * 30 + 1].data[5] ^= 4
    log[ALL * 40 + 4] = Message(
        log[ALL * 40 + 4].timestamp, 0x120, is_extended_id=False, data=b"\1\2\3"
    )
    loop, gaps = replay(log)
    assert listed(gaps) == Counter(
        {
            (20, NAMES[2], "wrong CRC"): 1,
            (30, NAMES[1], "wrong CRC"): 1,
            (40, NAMES[4], "wrong length"): 1,
        }
    )
    assert loop.comparison.without_input == 1
    assert loop.account.first_input_gap == 30
    assert loop.rejected()[NAMES[1]]["wrong_crc"] == 1


@pytest.mark.parametrize("step_s", [0.5, -0.25, 3600.0, -3600.0])
def test_a_clock_that_steps_changes_nothing_and_is_named(frames, step_s):
    log = deepcopy(frames)
    for frame in log[ALL * 150 :]:
        frame.timestamp += step_s + 7200.0
    for frame in log[: ALL * 150]:
        frame.timestamp += 7200.0
    loop, gaps = replay(log)
    (gap,) = gaps
    assert (gap.tick, gap.what) == (150, "clock step")
    assert float(gap.detail.split()[0]) == pytest.approx(step_s + 0.000996, abs=1e-6)
    assert loop.comparison.identical


def test_time_stamps_of_another_pace_are_no_clock_steps(frames):
    log = deepcopy(frames)
    for frame in log:
        frame.timestamp = 1.7e9 + frame.timestamp / 12.0  # lockstep, recorded by candump
    _, gaps = replay(log)
    assert gaps == []


def test_a_log_that_begins_late_says_so(frames):
    loop, gaps = replay(frames[ALL * 120 + 3 :])
    assert (loop.first_tick, loop.comparison.ticks) == (121, TICKS - 121)
    assert loop.before_start == 2
    assert gaps == []


def test_the_wire_tick_goes_round(frames):
    """65536 ticks are 16 bits; a drive across the end goes on counting."""
    shifted = []
    senders = [Transmitter(codec) for codec in NETWORK]
    for at, frame in enumerate(frames):
        tick, role = divmod(at, ALL)
        codec = list(NETWORK)[role]
        said = codec.decode(frame.data)
        one = senders[role].frame(said.value, tick + 65_400, said.mode, said.fault_state)
        one.timestamp = frame.timestamp + 65.4
        shifted.append(one)
    loop, gaps = replay(shifted)
    assert gaps == []
    assert loop.first_tick == 65_400
    assert loop.comparison.identical
    assert loop.comparison.compared == TICKS
