"""J1939's transport protocol: messages of more than 8 bytes, to all (BAM) and to one (RTS/CTS)."""

import json

import numpy as np
import pytest
from can import Message
from hypothesis import given, strategies as st

from can_rig.decoding.decode import Decoder, decode_log
from can_rig.decoding.j1939 import Transport
from can_rig.frames.databases import load_database
from can_rig.logs.frames import Frames, concatenate
from can_rig.logs.reading import read_log
from tests.helpers import asked
from tests.rig.logs.messages import from_messages

BY_CAN_J1939 = """\
(1795293514.969694) can0 18ECFF10#20090002FFCAFE00
(1795293515.020000) can0 1CEBFF10#014420823CFDE6F1
(1795293515.070187) can0 1CEBFF10#02C26BFFFFFFFFFF
(1795293515.215832) can0 18EC2010#100900020100EF00
(1795293515.215987) can0 1CEC1020#110101FFFF00EF00
(1795293515.216111) can0 1CEB2010#0130F90EC7DD01E4
(1795293515.216180) can0 1CEC1020#110102FFFF00EF00
(1795293515.216263) can0 1CEB2010#028875FFFFFFFFFF
(1795293515.216306) can0 1CEC1020#13090002FF00EF00
"""
"""9 bytes to all and 9 bytes to address 20 from address 10, as can-j1939 2.0 sends them."""

SENT = {
    0x18FECA10: bytes.fromhex("4420823cfde6f1c26b"),
    0x18EF2010: bytes.fromhex("30f90ec7dd01e48875"),
}
DBC = """\
VERSION ""
BU_: A
BO_ 2566834942 DM1: 20 A
 SG_ Lamp : 0|8@1+ (1,0) [0|0] "" A
 SG_ Last : 152|8@1+ (2,0) [0|0] "" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2566834942 3;
"""
DM1 = 0xFECA


def manage(control: int, size: int, group: int, source: int, to: int, at_s: float = 0.0) -> Message:
    data = [
        control, size & 0xFF, size >> 8, min(-(-size // 7), 255), 0xFF,
        *group.to_bytes(3, "little"),
    ]  # fmt: skip
    return sent(0xEC, data, source, to, at_s)


def sent(kind: int, data: list[int], source: int, to: int, at_s: float = 0.0) -> Message:
    identifier = 7 << 26 | kind << 16 | to << 8 | source
    return Message(at_s, identifier, True, data=bytes(data), channel="can0")


def packets(data: bytes, source: int, to: int, at_s: float = 0.0) -> list[Message]:
    padded = data + b"\xff" * (-len(data) % 7)
    return [
        sent(0xEB, [at // 7 + 1, *padded[at : at + 7]], source, to, at_s + at * 1e-4)
        for at in range(0, len(padded), 7)
    ]


def bam(data: bytes, source: int, group: int = DM1, at_s: float = 0.0) -> list[Message]:
    return [manage(32, len(data), group, source, 255, at_s), *packets(data, source, 255, at_s)]


def rts(data: bytes, source: int, to: int, group: int = 0xEF00) -> list[Message]:
    size = len(data)
    return [
        manage(16, size, group, source, to),
        manage(17, 0x101, group, to, source),
        *packets(data, source, to),
        manage(19, size, group, to, source),
    ]


def put_together(chunks: list[Frames]) -> tuple[Transport, list[tuple[int, int, bytes]]]:
    """Row, identifier and bytes of each complete message."""
    transport, found, count = Transport(), [], 0
    for frames in chunks:
        rows = np.arange(count, count + len(frames))
        count += len(frames)
        whole, at = transport.put_together(frames, rows)
        found += [
            (int(row), int(whole.arbitration_id[n]), whole.data[n, : whole.length[n]].tobytes())
            for n, row in enumerate(at)
        ]
    return transport, found


@pytest.mark.parametrize("chunk", [1, 3, 100])
def test_what_another_program_sends(tmp_path, chunk):
    (tmp_path / "a.log").write_text(BY_CAN_J1939, "ascii")
    transport, found = put_together(list(read_log(tmp_path / "a.log", chunk)))
    assert found == [(2, 0x18FECA10, SENT[0x18FECA10]), (7, 0x18EF2010, SENT[0x18EF2010])]
    assert (transport.messages, transport.incomplete) == (2, 0)


@given(st.data())
def test_any_messages_of_many_senders_at_once(data):
    """Each sender's frames in their order, the senders' mixed in any."""
    count = data.draw(st.integers(1, 5))
    queues, wanted = [], {}
    for source in range(count):
        content = data.draw(st.binary(min_size=9, max_size=60))
        to_one = data.draw(st.booleans())
        frames = rts(content, source, 0x80 + source) if to_one else bam(content, source)
        queues.append(frames)
        group = 0xEF00 | 0x80 + source if to_one else DM1
        wanted[7 << 26 | group << 8 | source] = content
    mixed = []
    while any(queues):
        mixed.append(data.draw(st.sampled_from([q for q in queues if q])).pop(0))
    transport, found = put_together([from_messages(mixed)])
    assert {identifier: content for _, identifier, content in found} == wanted
    assert transport.incomplete == 0
    for row, identifier, _ in found:
        assert mixed[row].arbitration_id & 0xFF == identifier & 0xFF


def test_the_longest_message():
    content = bytes(at % 251 for at in range(1785))
    assert put_together([from_messages(bam(content, 3))])[1][0][2] == content


def test_packets_that_a_receiver_asks_for_again():
    content = bytes(range(30))
    frames = rts(content, 1, 2)
    frames[4:4] = [*frames[2:4], manage(17, 0x102, 0xEF00, 2, 1)]
    assert [found[2] for found in put_together([from_messages(frames)])[1]] == [content]


@pytest.mark.parametrize(
    "damaged",
    [
        lambda frames: frames[:2] + frames[3:],  # a packet is missing
        lambda frames: frames[:-1],
        lambda frames: [frames[0], frames[2], frames[1], *frames[3:]],  # to all: in order
        lambda frames: [frames[0], sent(0xEB, [0, *bytes(7)], 1, 255), *frames[1:]],
        lambda frames: [frames[0], sent(0xEB, [255, *bytes(7)], 1, 255), *frames[1:]],
        lambda frames: [manage(32, 5, DM1, 1, 255), *frames[1:]],  # fits into one frame
        lambda frames: [manage(32, 2000, DM1, 1, 255), *frames[1:]],
        lambda frames: [manage(32, 20, DM1, 1, 7), *frames[1:]],  # BAM to one address
        lambda frames: [*frames[:2], manage(255, 0, DM1, 1, 255), *frames[2:]],  # aborted
        lambda frames: [*frames[:2], *packets(bytes(20), 1, 255, 1.3)[1:]],  # 1.25 s at most
    ],
)
def test_a_message_that_is_not_complete(damaged):
    transport, found = put_together([from_messages(damaged(bam(bytes(20), 1)))])
    assert found == []
    assert transport.incomplete == 1
    for frames in (rts(bytes(20), 1, 2), bam(b"\5" * 20, 1, at_s=9.0)):
        after = damaged(bam(bytes(20), 1)) + frames
        assert len(put_together([from_messages(after)])[1]) == 1  # the next one is


def test_what_is_no_frame_of_the_protocol():
    frames = bam(bytes(20), 1)
    short = Message(0.0, frames[1].arbitration_id, True, data=b"\1\2", channel="can0")
    base = Message(0.0, 0x6EB, False, data=bytes(8), channel="can0")
    page = Message(0.0, frames[1].arbitration_id | 1 << 24, True, data=bytes(8), channel="can0")
    other = frames[1].__copy__()
    other.channel = "can1"
    mixed = [frames[0], short, base, page, other, *frames[1:]]
    transport, found = put_together([from_messages(mixed)])
    assert len(found) == 1
    assert transport.incomplete == 0


def test_long_messages_are_decoded_beside_short_frames(tmp_path):
    (tmp_path / "a.dbc").write_text(DBC, "ascii")
    content = bytes([7, *bytes(18), 21])
    frames = [
        *bam(content, 0x21, at_s=1.0),
        Message(2.0, 0x18FECA99, True, data=bytes(8), channel="can0"),  # without Last
        *bam(content[::-1], 0x22, at_s=3.0),
        *bam(bytes(9), 0x22, group=0xFE00, at_s=4.0),  # in no database
        Message(5.0, 0x18FF0001, True, data=bytes(8), channel="can0"),
    ]
    database = load_database(tmp_path / "a.dbc")
    decoder = Decoder(database)
    whole = from_messages(frames)
    found = [decoder.decode(part) for part in (whole[:6], whole[6:])]
    values = [part["DM1"].signals for part in found]
    assert [v["Lamp"].tolist() for v in values] == [[7, 0], [21]]
    assert [v["Last"].tolist() for v in values] == [[42, None], [14]]
    assert [v["SourceAddress"].tolist() for v in values] == [[0x21, 0x99], [0x22]]
    assert found[0]["DM1"].row.tolist() == [3, 4]
    counts = decoder.counts["DM1"]
    assert (counts.frames, counts.decoded, counts.shorter) == (3, 3, 1)
    assert dict(decoder.unknown) == {"18FF0001": 1}
    assert dict(decoder.transport.unknown) == {"1CFE0022": 1}
    only = Decoder([("can1", database)])
    assert only.decode(whole) == {}
    assert only.unknown.total() == len(frames)


def test_the_command_says_what_became_of_them(tmp_path):
    (tmp_path / "a.dbc").write_text(DBC, "ascii")
    (tmp_path / "a.log").write_text(BY_CAN_J1939.replace("18ECFF10#2009", "18ECFF10#2008"), "ascii")
    done = asked("decode", tmp_path / "a.log", "--dbc", tmp_path / "a.dbc")
    assert "J1939 messages put together: 1 (not in the database: 1), incomplete: 1" in done.stdout
    done = asked("decode", tmp_path / "a.log", "--dbc", tmp_path / "a.dbc", "--json")
    assert json.loads(done.stdout)["transport"] == {
        "messages": 1,
        "incomplete": 1,
        "unknown": {"18EF2010": 1},
    }
    (tmp_path / "b.log").write_text(BY_CAN_J1939, "ascii")
    assert decode_log(tmp_path / "b.log", tmp_path / "a.dbc").transport.messages == 2
    assert len(concatenate(read_log(tmp_path / "b.log"))) == 9
