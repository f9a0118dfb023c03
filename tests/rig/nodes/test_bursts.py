"""Frames as bursts on the local bus: the same bytes, the same log, the same refusals."""

import select

import can
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from can_rig.buses.bus import open_bus, open_for_node
from can_rig.buses.local.bus import HEADER
from can_rig.frames.codec import Receiver, Transmitter
from can_rig.nodes.bursts import Bursts
from can_rig.nodes.bus_access import SYSTEM_CLOCK, PersistentSender
from can_rig.nodes.recording import CandumpLines
from tests.rig.nodes.ends import NETWORK

OWN = (NETWORK.command_1, NETWORK.command_2, NETWORK.status)
VALUES = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-50.0, 50.0)


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Two nodes' ends of a bus, joined for bursts."""
    name = f"local:{tmp_path_factory.mktemp('bus')}"
    with open_for_node(name, [], True) as one, open_for_node(name, [], True) as other:
        yield one, other, name


def sender_of(bus, lines=None):
    return Bursts(bus, PersistentSender(bus, 1.0, SYSTEM_CLOCK), OWN, [Receiver(OWN[0])], lines)


def receivers_of():
    return [Receiver(codec) for codec in OWN]


def reader_of(bus, receivers, lines=None):
    return Bursts(bus, PersistentSender(bus, 1.0, SYSTEM_CLOCK), OWN[:1], receivers, lines)


def received(bus):
    while (message := bus.recv(0)) is not None:
        yield message


@settings(max_examples=60)
@given(st.lists(st.tuples(*[VALUES] * 3, *[st.integers(-1, 20)] * 3), min_size=1, max_size=20),
       st.integers(0, 200_000))  # fmt: skip
def test_a_burst_has_the_bytes_of_single_frames(two, ticks, first):
    bus, other, _ = two
    transmitters = [Transmitter(codec) for codec in OWN]
    lines, single_lines = CandumpLines(), CandumpLines()
    sender = sender_of(bus, lines)
    for tick, (one, two_, three, *codes) in enumerate(ticks, first):
        for each in (lines, single_lines):
            each.at(tick * 1000)
        sender.send(tick, (one, two_, three), *codes)
        singles = [
            transmitter.frame(value, tick, *codes)
            for transmitter, value in zip(transmitters, (one, two_, three), strict=True)
        ]
        for frame in singles:
            single_lines.record(frame, sent=True)
        assert [(m.arbitration_id, m.data) for m in received(other)] == [
            (m.arbitration_id, m.data) for m in singles
        ]
    assert lines.take() == single_lines.take()


WRONGS = st.sampled_from(
    ["as it is"] * 6 + ["damaged", "lost", "again", "old", "of another", "bad tick"]
)


@settings(max_examples=60)
@given(st.lists(st.tuples(WRONGS, st.integers(0, 2), VALUES, st.integers(0, 63)), max_size=40))
def test_bursts_are_judged_like_single_frames(two, ticks):
    bus, other, _ = two
    transmitters = [Transmitter(codec) for codec in OWN]
    judges, expected_judges = receivers_of(), receivers_of()
    lines, expected_lines = CandumpLines(), CandumpLines()
    reader = reader_of(other, judges, lines)
    last = None
    for tick, (wrong, place, value, bit) in enumerate(ticks):
        frames = [each.frame(value, tick + (wrong == "bad tick")) for each in transmitters]
        if wrong == "damaged":
            frames[place].data[bit // 8] ^= 1 << bit % 8
        elif wrong == "lost":
            del frames[place]
        elif wrong == "of another":
            frames.insert(place, can.Message(arbitration_id=0x7, data=b"12345678"))
        elif wrong == "again":
            frames.insert(place, frames[place])
        elif wrong == "old" and last:
            frames[place] = last[place]
        last = frames if len(frames) == 3 else last
        put(bus, frames)
        expected = judge(expected_judges, expected_lines, frames, tick)
        found = reader.receive(tick)
        if found is None:
            found = judge(judges, lines, list(received(other)), tick)
        assert np.array_equal(found, expected, equal_nan=True)
    assert [each.rejected for each in judges] == [each.rejected for each in expected_judges]
    assert lines.take() == expected_lines.take()


def put(bus, frames):
    """Frames on the bus, three of them as a burst."""
    if len(frames) != 3:
        for frame in frames:
            bus.send(frame)
        return
    parts = [HEADER.pack(0.0, frame.arbitration_id, 0, 8) + frame.data for frame in frames]
    bus.send_burst(memoryview(b"".join(parts)))


def judge(receivers, lines, frames, tick):
    """The values of a tick's frames, nan for none."""
    values = [np.nan] * len(receivers)
    for frame in frames:
        lines.record(frame, sent=False)
        for at, receiver in enumerate(receivers):
            if receiver.codec.frame_id == frame.arbitration_id:
                record = receiver.accept(frame, tick)
                values[at] = values[at] if record is None else record.value
    for receiver in receivers:
        receiver.end_tick()
    return values


def test_any_other_listener_is_readable_for_every_frame_of_a_burst(two):
    bus, other, name = two
    with open_bus(name) as listener:
        sender_of(bus).send(3, (1.0, 2.0, 3.0))
        for codec in OWN:
            assert select.select([listener], [], [], 1.0)[0]
            assert listener.recv(0).arbitration_id == codec.frame_id
    assert len(list(received(other))) == len(OWN)


def test_single_frames_among_bursts_keep_their_order(two):
    bus, other, _ = two
    sender = sender_of(bus)
    single = can.Message(arbitration_id=0x55, is_extended_id=False, data=b"\1")
    bus.send(single)
    sender.send(0, (1.0, 2.0, 3.0))
    bus.send(single)
    ids = [message.arbitration_id for message in received(other)]
    assert ids == [0x55, *(codec.frame_id for codec in OWN), 0x55]
