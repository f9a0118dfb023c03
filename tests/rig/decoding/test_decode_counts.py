"""What is not decoded is counted: damaged, lost, unknown and unwanted frames."""

import asammdf
import cantools
import pytest
from can import Message
from e2e.p01 import e2e_p01_protect
from hypothesis import given, settings, strategies as st

from can_rig.decoding.decode import Decoder
from can_rig.decoding.files import Contents, output
from can_rig.errors import DbcError
from can_rig.frames.codec import COUNTERS, Checker, CheckStatus
from can_rig.frames.databases import load_database
from tests.helpers import DBC
from tests.rig.decoding.databases import FEATURES
from tests.rig.logs.messages import from_messages

RIG = DBC / "steer_by_wire.dbc"


def protected(counters: list[int], data_id: int) -> list[bytes]:
    frames = []
    for counter in counters:
        data = bytearray(8)
        data[4] = counter
        data[1] = counter
        e2e_p01_protect(data, data_id, increment_counter=False)
        frames.append(bytes(data))
    return frames


@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(st.integers(0, 14), st.sampled_from(["good", "good", "good", "bad", "short"])),
        max_size=40,
    ),
    st.integers(0, 40),
)
def test_protected_frames_are_judged_as_the_receiver_judges_them(draws, middle):
    """By a `Checker` that misses a frame of every counter between two frames, so that every step is
    tolerated: a log has no empty ticks.
    """
    database = load_database(RIG)
    message = database.messages[0]
    data_id = message.dbc.attributes["E2EDataId"].value
    checker = Checker(data_id)
    frames, statuses = [], []
    for (_, fate), sent in zip(
        draws, protected([counter for counter, _ in draws], data_id), strict=True
    ):
        damaged = {
            "good": sent,
            "bad": sent[:5] + bytes([sent[5] ^ 1]) + sent[6:],
            "short": sent[:7],
        }
        data = damaged[fate]
        frames.append(Message(arbitration_id=message.frame_id, is_extended_id=False, data=data))
        for _ in range(COUNTERS):
            checker.no_new_data()
        statuses.append(checker.check(bytearray(data)))
    decoder = Decoder(database)
    chunks = [decoder.decode(from_messages(part)) for part in (frames[:middle], frames[middle:])]
    counts = decoder.counts[message.name]
    usable = [
        s in (CheckStatus.OK, CheckStatus.INITIAL, CheckStatus.OK_SOME_LOST) for s in statuses
    ]
    rows = [r for chunk in chunks for c in chunk.values() for r in c.row.tolist()]
    assert rows == [row for row, fit in enumerate(usable) if fit]
    assert counts.frames == len(frames)
    assert counts.wrong_crc == statuses.count(CheckStatus.WRONG_CRC)
    assert counts.too_short == statuses.count(CheckStatus.WRONG_LENGTH)
    assert counts.repeated == statuses.count(CheckStatus.REPEATED)
    assert counts.gaps == statuses.count(CheckStatus.OK_SOME_LOST)


def test_lost_frames_are_those_that_were_taken_out():
    database = load_database(RIG)
    (message,) = (m for m in database.messages if m.name == "DSTAR_REFERENCE")
    data_id = message.dbc.attributes["E2EDataId"].value
    kept = [n for n in range(100) if n not in {5, 20, 21, 22, 99}]
    data = protected([n % 15 for n in kept], data_id)
    frames = [Message(arbitration_id=message.frame_id, is_extended_id=False, data=d) for d in data]
    decoder = Decoder(database)
    decoder.decode(from_messages(frames))
    counts = decoder.counts[message.name]
    assert (counts.gaps, counts.lost, counts.decoded) == (2, 4, 95)


def test_every_frame_is_accounted_for():
    database = load_database(RIG)
    same_number = {"arbitration_id": 0x100, "data": bytes(8)}
    frames = [
        Message(arbitration_id=0x100, is_extended_id=False, data=bytes(8)),
        Message(**same_number),  # extended: another frame
        Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True, dlc=8),
        Message(arbitration_id=0x7FF, is_extended_id=False),
        Message(arbitration_id=0x100, is_extended_id=False, is_error_frame=True),
    ]
    decoder = Decoder(database)
    assert len(decoder.decode(from_messages(frames))["DSTAR_REFERENCE"]) == 0
    counts = decoder.counts["DSTAR_REFERENCE"]
    assert (counts.frames, counts.wrong_crc, counts.remote) == (2, 1, 1)
    assert dict(decoder.unknown) == {"00000100": 1, "7FF": 1}
    assert (decoder.frames, decoder.error_frames) == (5, 1)


def test_frames_that_become_too_short_in_an_mdf_file(tmp_path):
    """The first chunk does not show that a signal will be missing."""
    database = cantools.database.load_string(FEATURES, "dbc")
    decoder = Decoder(database)
    with output(tmp_path / "a.mf4", Contents({}, 0, False), force=False) as file:
        for at, size in enumerate((8, 4, 0)):
            sent = Message(at, 1024, is_extended_id=False, data=bytes(size))
            file.write(decoder.decode(from_messages([sent])))
    counts = decoder.counts["BIG"]
    assert (counts.decoded, counts.shorter, counts.too_short) == (2, 1, 1)
    with asammdf.MDF(tmp_path / "a.mf4") as opened:
        assert opened.get("Odometer").timestamps.tolist() == [0, 1]
        assert opened.get("Temp").timestamps.tolist() == [0]


def test_a_message_without_signals_has_no_group_in_an_mdf_file(tmp_path):
    database = cantools.database.load_string("BO_ 1 BARE: 8 A\n", "dbc")
    decoder = Decoder(database)
    with output(tmp_path / "a.mf4", Contents({}, 0, False), force=False) as file:
        for at in range(2):
            sent = Message(at, 1, is_extended_id=False, data=bytes(8))
            file.write(decoder.decode(from_messages([sent])))
    assert decoder.counts["BARE"].decoded == 2
    with asammdf.MDF(tmp_path / "a.mf4") as opened:
        assert opened.groups == []


def test_channels_are_told_apart():
    database = cantools.database.load_string(FEATURES, "dbc")
    frames = [
        Message(arbitration_id=1024, is_extended_id=False, data=bytes(8), channel=name)
        for name in ("can0", "can1", "can1")
    ]
    decoder = Decoder(database, channel="can1")
    assert len(decoder.decode(from_messages(frames))["BIG"]) == 2
    assert (decoder.not_wanted, decoder.nothing_on_channel) == (1, None)
    decoder = Decoder(database, channel="can7")
    assert decoder.decode(from_messages(frames)) == {}
    assert "can0, can1" in decoder.nothing_on_channel


def test_only_what_is_wanted():
    database = cantools.database.load_string(FEATURES, "dbc")
    frames = [
        Message(arbitration_id=1024, is_extended_id=False, data=bytes(8)),
        Message(arbitration_id=200, is_extended_id=False, data=bytes(8)),
    ]
    chunk = Decoder(database, signals=["BIG.Temp", "LEFT"]).decode(from_messages(frames))
    assert {name: list(columns.signals) for name, columns in chunk.items()} == {
        "SENSOR_SONARS": ["LEFT"],
        "BIG": ["Temp"],
    }
    decoder = Decoder(database, messages=["BIG"])
    assert list(decoder.decode(from_messages(frames))) == ["BIG"]
    assert decoder.not_wanted == 1
    with pytest.raises(DbcError, match=r"no signal Tmp in the database; it has .*Temp"):
        Decoder(database, signals=["Tmp"])
    with pytest.raises(DbcError, match="no message BIGG"):
        Decoder(database, messages=["BIGG"])


def test_a_signal_that_does_not_fit_is_left_out():
    text = FEATURES.replace("Temp : 36|7@0-", "Temp : 60|16@0-")
    database = cantools.database.load_string(text, "dbc", strict=False)
    decoder = Decoder(database)
    assert decoder.left_out == ["BIG.Temp"]
    frame = Message(arbitration_id=1024, is_extended_id=False, data=bytes(8))
    columns = decoder.decode(from_messages([frame]))["BIG"]
    others = {s.name for s in database.get_message_by_name("BIG").signals} - {"Temp"}
    assert set(columns.signals) == others
