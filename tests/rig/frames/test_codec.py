"""Record ↔ 8 bytes: bit-exact with cantools, saturating, and never raising in the loop."""

import math

import can
import cantools
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from can_rig.frames.codec import CheckStatus, Receiver, Record, Transmitter
from can_rig.frames.network import load_network
from firmware_model.law.status import Verdict
from tests.helpers import DBC

STEER_BY_WIRE = DBC / "steer_by_wire.dbc"
PAIRS = [
    (codec, cantools.database.load_file(path, strict=True).get_message_by_name(codec.name))
    for path in (STEER_BY_WIRE, DBC / "plant_by_numbers.dbc")
    for codec in load_network(path)
]

codec_pairs = st.sampled_from(PAIRS)
codecs = codec_pairs.map(lambda pair: pair[0])
ticks = st.integers(0, 2**40)
floats = st.one_of(st.floats(), st.floats(-30, 30), st.floats(-3e6, 3e6))
raws = st.one_of(st.integers(-(2**31) + 1, 2**31 - 1), st.sampled_from([1 - 2**31, 0, 2**31 - 1]))
two_bits = st.integers(0, 3)
verdicts = st.sampled_from(Verdict)


@given(codec_pairs, floats, ticks, two_bits, two_bits, verdicts)
def test_bytes_are_those_of_cantools(pair, value, tick, mode, fault_state, verdict):
    codec, message = pair
    sent = codec.quantise(value)
    signals = {
        "Checksum": 0,
        "AliveCounter": 0,
        "Tick": tick % 65536,
        codec.signal_name: "NOT_AVAILABLE" if math.isnan(sent) else sent,
    }
    if codec.modes:
        signals |= {"Mode": mode, "FaultState": fault_state, "Verdict": verdict}
    strict = not math.isnan(sent)  # NOT_AVAILABLE lies outside the range, by intention
    expected = message.encode(signals, strict=strict)
    assert codec.encode(value, tick, mode, fault_state, verdict) == expected


@given(codec_pairs, raws, st.binary(min_size=4, max_size=4))
def test_decoding_is_that_of_cantools_bit_for_bit(pair, raw, header):
    codec, message = pair
    assume(codec.to_raw(math.nan) != raw >> codec.layout.verdict_bits)
    data = header + raw.to_bytes(4, "little", signed=True)
    record, expected = codec.decode(data), message.decode(data, decode_choices=False)
    assert record.value == expected[codec.signal_name]
    assert record.tick == expected["Tick"]
    said = tuple(expected.get(name, 0) for name in ("Mode", "FaultState", "Verdict"))
    assert (record.mode, record.fault_state, record.verdict) == said


@given(codecs, floats, ticks)
def test_what_arrives_is_the_quantised_value(codec, value, tick):
    sent = codec.quantise(value)
    for given_value in (value, sent):
        record = codec.decode(codec.encode(given_value, tick))
        assert record.tick == tick % 65536
        assert record.value == sent or (math.isnan(record.value) and math.isnan(value))


@given(codecs, st.floats(allow_nan=False))
def test_quantise_saturates_and_rounds_to_the_nearest_step(codec, value):
    sent = codec.quantise(value)
    assert codec.minimum <= sent <= codec.maximum
    if value >= codec.maximum:
        assert sent == codec.maximum
    elif value <= codec.minimum:
        assert sent == codec.minimum
    else:
        assert abs(sent - value) <= codec.lsb / 2 * (1 + 1e-6)
        assert sent == np.rint(value / codec.lsb) * codec.lsb  # as the firmware rounds


@given(st.integers(), st.integers(), st.integers(), st.tuples(two_bits, two_bits, verdicts))
def test_status_words_saturate_and_touch_nothing_else(mode, fault_state, verdict, good):
    status = load_once()
    data = status.encode(-1.5, 7, mode, fault_state, verdict)
    ends = (min(max(word, 0), end) for word, end in ((mode, 3), (fault_state, 3), (verdict, 15)))
    assert status.decode(data) == Record(-1.5, 7, *ends)
    assert data[1] & 0x0F == 0
    assert status.decode(status.encode(0.0, 0, *good))[2:] == good
    assert status.decode(status.encode(0.0, 0))[2:] == (0, 0, 0)


def load_once():
    return next(codec for codec, _ in PAIRS if codec.role == "status")


@given(codecs, st.lists(st.tuples(floats.filter(lambda x: not math.isnan(x)), ticks), max_size=40))
def test_transmitter_and_receiver(codec, sequence):
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    for value, tick in sequence:
        message = transmitter.frame(value, tick, 1, 2, 8)
        assert (message.arbitration_id, message.is_extended_id) == (codec.frame_id, False)
        assert message.dlc == 8
        assert message.timestamp == 0.0  # the node or the bus says when
        words = (1, 2, 8) if codec.modes else (0, 0, 0)
        assert receiver.accept(message) == (codec.quantise(value), tick % 65536, *words)
    counts = receiver.checker.counts
    assert counts[CheckStatus.OK] + counts[CheckStatus.INITIAL] == len(sequence)


def test_receiver_refuses_and_counts():
    codec = load_network(STEER_BY_WIRE).feedback
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    first = transmitter.frame(1.0, 0)
    assert receiver.accept(first) is not None
    assert receiver.accept(first) is None
    damaged = transmitter.frame(1.0, 1)
    damaged.data[4] ^= 1
    assert receiver.accept(damaged) is None
    short = can.Message(arbitration_id=codec.frame_id, is_extended_id=False, data=b"123")
    assert receiver.accept(short) is None
    without = receiver.accept(transmitter.frame(math.nan, 2))
    assert math.isnan(without.value)  # an intact frame that says NOT_AVAILABLE
    assert without.tick == 2
    assert receiver.accept(transmitter.frame(2.0, 3)) == Record(2.0, 3)
    counts = {status.name: n for status, n in receiver.checker.counts.items() if n}
    assert counts == {
        "INITIAL": 1, "REPEATED": 1, "WRONG_CRC": 1, "WRONG_LENGTH": 1, "OK_SOME_LOST": 1, "OK": 1,
    }  # fmt: skip
    assert receiver.rejected == {"repeated": 1, "wrong_crc": 1, "wrong_length": 1}


def missing(receiver):
    return receiver.checker.counts[CheckStatus.NO_NEW_DATA]


def test_a_tick_without_a_frame_is_told_to_the_checker():
    """The checker then expects the next counter and counts the lost frames."""
    codec = load_network(STEER_BY_WIRE).command_1
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    receiver.end_tick()
    assert missing(receiver) == 1  # nothing has come yet
    for tick in range(4):
        assert receiver.accept(transmitter.frame(1.0, tick), tick) is not None
        receiver.end_tick()
        assert missing(receiver) == 1
    for tick in range(4, 9):
        transmitter.frame(1.0, tick)  # lost
        receiver.end_tick()
        assert missing(receiver) == tick - 2
    assert receiver.accept(transmitter.frame(2.0, 9), 9) == Record(2.0, 9)


def test_a_damaged_frame_was_there_but_one_of_another_tick_was_not():
    codec = load_network(STEER_BY_WIRE).command_1
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    damaged = transmitter.frame(1.0, 0)
    damaged.data[5] ^= 1
    assert receiver.accept(damaged, 0) is None
    receiver.end_tick()
    assert missing(receiver) == 0
    assert receiver.accept(transmitter.frame(1.0, 9), 1) is None
    receiver.end_tick()
    assert missing(receiver) == 1


@pytest.mark.parametrize("kind", ["is_extended_id", "is_remote_frame", "is_error_frame"])
def test_a_frame_of_another_kind_with_the_same_number_touches_nothing(kind):
    codec = load_network(STEER_BY_WIRE).feedback
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    stranger = transmitter.frame(1.0, 0)
    setattr(stranger, kind, True)
    before = receiver.checker.counts
    assert receiver.accept(stranger, 0) is None
    assert receiver.checker.counts == before
    assert receiver.accept(transmitter.frame(2.0, 1), 1) == Record(2.0, 1)


@given(codecs, st.integers(0, 2**40), st.integers(1, 65535))
def test_a_frame_of_another_tick_is_counted_and_its_counter_is_not_looked_at(codec, tick, off):
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    assert receiver.accept(transmitter.frame(1.0, tick), tick) is not None
    intruder = Transmitter(codec)
    for _ in range(7):  # counters that would break the sequence
        assert receiver.accept(intruder.frame(9.0, tick + 1 + off), tick + 1) is None
    assert receiver.rejected == {"wrong_tick": 7}
    following = receiver.accept(transmitter.frame(2.0, tick + 1), tick + 1)
    assert following == Record(codec.quantise(2.0), (tick + 1) % 65536)
    assert receiver.checker.counts[CheckStatus.OK] == 1
