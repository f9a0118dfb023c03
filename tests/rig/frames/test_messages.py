"""Records and frames: bit-exact with cantools, saturating, and never raising in the loop."""

import math
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_rig.errors import DbcError, RigError
from can_rig.frames.layout import ROLES
from can_rig.frames.messages import Receiver, Record, Transmitter, load_network
from can_rig.frames.protection import CheckStatus

DBC = Path(__file__).parents[3] / "dbc"
STEER_BY_WIRE = DBC / "steer_by_wire.dbc"
PAIRS = [
    (codec, cantools.database.load_file(path, strict=True).get_message_by_name(codec.name))
    for path in (STEER_BY_WIRE, DBC / "chapter_2.dbc")
    for codec in load_network(path)
]

codec_pairs = st.sampled_from(PAIRS)
codecs = codec_pairs.map(lambda pair: pair[0])
raws = st.one_of(st.integers(-(2**31) + 1, 2**31 - 1), st.sampled_from([1 - 2**31, 0, 2**31 - 1]))
ticks = st.integers(0, 2**40)
floats = st.one_of(st.floats(), st.floats(-30, 30), st.floats(-3e6, 3e6))
two_bits = st.integers(0, 3)


def test_network_holds_one_frame_of_every_role():
    network = load_network(STEER_BY_WIRE)
    assert tuple(codec.role for codec in network) == ROLES
    assert network.command_1.signal_name == "SteerTorque"
    assert network.command_1.unit == "N.m"
    assert network.feedback.sender == "PLANT"
    assert network.status.modes[2] == "HOLD"
    assert network.status.fault_states[3] == "CANNOT_TELL"
    assert network.feedback.modes == {}


def test_the_value_tables_are_the_firmware_s():
    from firmware_model.target.status import FaultState, Mode

    status = load_network(STEER_BY_WIRE).status
    assert status.modes == {int(mode): mode.name for mode in Mode}
    assert status.fault_states == {int(state): state.name for state in FaultState}


@given(codec_pairs, floats, ticks, two_bits, two_bits)
def test_bytes_are_those_of_cantools(pair, value, tick, mode, fault_state):
    codec, message = pair
    sent = codec.quantise(value)
    signals = {
        "Checksum": 0,
        "AliveCounter": 0,
        "Tick": tick % 65536,
        codec.signal_name: "NOT_AVAILABLE" if math.isnan(sent) else sent,
    }
    if codec.modes:
        signals |= {"Mode": mode, "FaultState": fault_state}
    strict = not math.isnan(sent)  # NOT_AVAILABLE lies outside the range, by intention
    expected = message.encode(signals, strict=strict)
    assert codec.encode(value, tick, mode, fault_state) == expected


@given(codec_pairs, raws, st.binary(min_size=4, max_size=4))
def test_decoding_is_that_of_cantools_bit_for_bit(pair, raw, header):
    codec, message = pair
    data = header + raw.to_bytes(4, "little", signed=True)
    record, expected = codec.decode(data), message.decode(data, decode_choices=False)
    assert record.value == expected[codec.signal_name]
    assert record.tick == expected["Tick"]
    assert (record.mode, record.fault_state) == (
        expected.get("Mode", 0),
        expected.get("FaultState", 0),
    )


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


@given(codecs, st.floats(allow_nan=False), st.floats(allow_nan=False))
def test_quantise_is_monotonic(codec, a, b):
    low, high = sorted((a, b))
    assert codec.quantise(low) <= codec.quantise(high)


@pytest.mark.parametrize("codec", [codec for codec, _ in PAIRS], ids=lambda codec: codec.name)
def test_ends_and_infinities(codec):
    beyond = np.nextafter(codec.maximum, np.inf)
    for value in (codec.maximum, beyond, 1e300, math.inf):
        assert codec.decode(codec.encode(value, 0)).value == codec.maximum
        assert codec.decode(codec.encode(-value, 0)).value == codec.minimum == -codec.maximum
    assert codec.encode(math.nan, 0)[4:] == b"\x00\x00\x00\x80"
    assert math.isnan(codec.quantise(math.nan))
    assert math.isnan(codec.decode(codec.encode(math.nan, 0)).value)


@given(st.integers(), st.integers(), two_bits, two_bits)
def test_status_words_saturate_and_touch_nothing_else(mode, fault_state, good, other):
    status = load_once()
    data = status.encode(1.5, 7, mode, fault_state)
    assert status.decode(data) == Record(1.5, 7, min(max(mode, 0), 3), min(max(fault_state, 0), 3))
    assert data[1] & 0x0F == 0
    assert status.decode(status.encode(0.0, 0, good, other))[2:] == (good, other)


def load_once():
    return next(codec for codec, _ in PAIRS if codec.role == "status")


@given(codecs, st.lists(st.tuples(floats.filter(lambda x: not math.isnan(x)), ticks), max_size=40))
def test_transmitter_and_receiver(codec, sequence):
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    for value, tick in sequence:
        message = transmitter.frame(value, tick, 1, 2)
        assert (message.arbitration_id, message.is_extended_id) == (codec.frame_id, False)
        assert message.dlc == 8
        words = (1, 2) if codec.modes else (0, 0)
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


def test_layout_variant_with_swapped_status_words(tmp_path):
    text = STEER_BY_WIRE.read_text().replace("Mode : 12|2", "Mode : 14|2")
    text = text.replace("FaultState : 14|2", "FaultState : 12|2")
    path = tmp_path / "swapped.dbc"
    path.write_text(text)
    status = load_network(path).status
    message = cantools.database.load_file(path).get_message_by_name(status.name)
    decoded = message.decode(status.encode(0.0, 0, 1, 2), decode_choices=False)
    assert (decoded["Mode"], decoded["FaultState"]) == (1, 2)


def test_a_narrower_range_saturates_there_and_what_lies_beyond_is_not_a_value(tmp_path):
    path = tmp_path / "narrow.dbc"
    wide = '[-2147483.647|2147483.647] "N.m"'
    path.write_text(STEER_BY_WIRE.read_text().replace(wide, '[-100|50.5] "N.m"'))
    codec = load_network(path).command_1
    assert (codec.quantise(-1e9), codec.quantise(1e9)) == (-100.0, 50.5)
    assert math.isnan(codec.decode(bytes(4) + (50_501).to_bytes(4, "little")).value)


ROLE_FEEDBACK = 'BA_ "RigRole" BO_ 257 2;'
DSTAR_PLACE = "DStar : 32|32@1- (1E-008,0)"
DSTAR = f"{DSTAR_PLACE} [-21.47483647|21.47483647]"
EXTRA = 'SG_ Extra : 12|4@1+ (1,0) [0|15] ""  CONTROLLER'

BAD = {
    "role missing": (ROLE_FEEDBACK, "", "no message has RigRole feedback"),
    "role none": (ROLE_FEEDBACK, 'BA_ "RigRole" BO_ 257 0;', "no message has RigRole feedback"),
    "role twice": (ROLE_FEEDBACK, 'BA_ "RigRole" BO_ 257 1;', "both have RigRole reference"),
    "data id missing": ('BA_ "E2EDataId" BO_ 257 23313;', "", "E2EDataId is None; it must be 1"),
    "data id zero": ("BO_ 257 23313;", "BO_ 257 0;", "E2EDataId is 0; it must be 1..65535"),
    "data id twice": ("BO_ 257 23313;", "BO_ 257 23312;", "give the same CRC"),
    "data id collides": ("BO_ 257 23313;", "BO_ 257 123;", "give the same CRC"),
    "length": ("257 DSTAR_FEEDBACK: 8", "257 DSTAR_FEEDBACK: 9", "it must be a classic one of 8"),
    "extended": ("257", "2147483905", "an extended frame of 8 bytes"),
    "checksum place": ("Checksum : 0|8@1+", "Checksum : 0|7@1+", "signal Checksum is unsigned"),
    "checksum name": ("Checksum : 0|8@1+", "Crc : 0|8@1+", "no signal Checksum"),
    "counter sign": ("AliveCounter : 8|4@1+", "AliveCounter : 8|4@1-", "AliveCounter is signed"),
    "tick scaled": ('Tick : 16|16@1+ (1,0)', "Tick : 16|16@1+ (2,0)", "signal Tick is unsigned"),
    "value place": (DSTAR, DSTAR.replace("32|32", "32|31"), "it must be signed Intel, 32 bits"),
    "value unsigned": (DSTAR, DSTAR.replace("1-", "1+", 1), "DStar is unsigned"),
    "value Motorola": (DSTAR, DSTAR.replace("32|32@1", "39|32@0"), "DStar is signed Motorola"),
    "value offset": (DSTAR, DSTAR.replace(",0)", ",1)"), "offset 1"),
    "value factor": (DSTAR, DSTAR.replace("(1E", "(-1E"), "factor above 0"),
    "range empty": (DSTAR, f"{DSTAR_PLACE} [0|0]", "it must include 0"),
    "range without 0": (DSTAR, f"{DSTAR_PLACE} [1|5]", "has range 1..5; it must include 0"),
    "range too wide": (DSTAR, DSTAR.replace("-21.47483647", "-21.47483648"), "at most 2147483647"),
    "range off the grid": (DSTAR, DSTAR.replace("|21.47483647", "|0.000000015"), "multiples of"),
    "second value": (f"SG_ {DSTAR}", f"{EXTRA}\n SG_ {DSTAR}", "beside those of the header"),
    "no mode": ("Mode ", "Moode ", "no signal Mode"),
    "mode place": ("SG_ Mode : 12|2", "SG_ Mode : 12|1", "signal Mode is unsigned"),
    "mode words": ('0 "INIT" 1 "RUN" 2 "HOLD"', '0 "INIT"', "Mode must have a value table"),
    "overlap": ("FaultState : 14|2", "FaultState : 12|2", "overlapping"),
    "no sender": ("DSTAR_FEEDBACK: 8 PLANT", "DSTAR_FEEDBACK: 8 Vector__XXX", "0 senders"),
    "not a DBC": ("BU_:", "BU", "not a DBC that can be loaded"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "reason"), BAD.values(), ids=BAD.keys())
def test_bad_dbc_is_refused_with_its_reason(old, new, reason, tmp_path):
    text = STEER_BY_WIRE.read_text()
    assert old in text
    path = tmp_path / "bad.dbc"
    path.write_text(text.replace(old, new))
    with pytest.raises(DbcError) as caught:
        load_network(path)
    message = str(caught.value)
    assert reason in message
    assert message.startswith(str(path))
    assert "\n" not in message
    assert isinstance(caught.value, RigError)


def test_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(DbcError, match=r"none\.dbc: cannot be read: No such file"):
        load_network(tmp_path / "none.dbc")
