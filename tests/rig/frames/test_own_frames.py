"""Frames of one's own, end to end: no protection, no tick, CAN FD, floats."""

import math

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from can_rig.frames.codec import CheckStatus, Receiver, Transmitter
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.rig.own_frames.scenarios import FD_SIGNALS, MOTOROLA, SIGNALS, database, options

LARGEST = float(np.finfo(np.float32).max)


@pytest.fixture(scope="module")
def floats(tmp_path_factory):
    dbc = tmp_path_factory.mktemp("floats") / "fd.dbc"
    dbc.write_text(database("64|32@1- (1,0) [0|0]", 12, 0x98FF0000, types="1", fd=True))
    ids = {"reference": 1, "feedback": 2, "command_1": 3, "command_2": 4, "status": 5}
    return network_of(load("default", options(dbc, FD_SIGNALS, data_ids=ids)))


def test_without_protection_length_and_tick_decide_and_everything_is_counted():
    codec = network_of(load("default", options(MOTOROLA, SIGNALS))).command_1
    assert not codec.protected
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    good, late, again, late_too = (transmitter.frame(1.5, tick) for tick in (7, 8, 7, 9))
    short = transmitter.frame(1.5, 7)
    short.data = short.data[:-1]
    accepted = [receiver.accept(message, 7) for message in (good, late, again, late_too, short)]
    assert [record and record.value for record in accepted] == [1.5, None, 1.5, None, None]
    receiver.end_tick()  # there was a frame
    receiver.end_tick()
    assert receiver.checker.no_new_data() == CheckStatus.NO_NEW_DATA
    assert {status.name: n for status, n in receiver.checker.counts.items() if n} == {
        "OK": 2, "WRONG_TICK": 2, "WRONG_LENGTH": 1, "NO_NEW_DATA": 2,
    }  # fmt: skip
    assert receiver.rejected == {"wrong_tick": 2, "wrong_length": 1, "no_new_data": 2}


@pytest.mark.parametrize(("now", "said"), [(70_000, 70_000 - 65_536), (3, 3), (0, 0), (None, 0)])
def test_a_frame_that_says_no_tick_is_of_the_tick_under_way(now, said):
    codec = network_of(load("default", options(MOTOROLA, SIGNALS, ""))).feedback
    record = Receiver(codec).accept(Transmitter(codec).frame(0.5, 9), now)
    assert record is not None and record.tick == said


def test_a_classic_frame_of_the_same_number_is_another(floats):
    codec = floats.command_1
    assert codec.protected
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    classic = transmitter.frame(1.0, 0)
    classic.is_fd = False
    assert receiver.accept(classic) is None
    assert not any(receiver.checker.counts.values())
    assert receiver.accept(transmitter.frame(1.0, 1)) is not None


@given(value=st.floats())
@example(value=math.nan)
def test_a_float_is_sent_as_ieee_754_has_it_and_saturates(floats, value):
    inside = min(max(value, -LARGEST), LARGEST) if not math.isnan(value) else value
    expected = float(np.float32(inside))
    np.testing.assert_equal(floats.command_1.to_raw(value), expected)
    np.testing.assert_equal(floats.command_1.quantise(value), expected)
