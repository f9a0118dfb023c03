"""Several buses, each with its own database; and J1939 messages by their parameter groups."""

import json

import pytest
from can import Message
from hypothesis import given, strategies as st

from can_rig.decoding.decode import Decoder, decode_log
from can_rig.decoding.j1939 import group_key
from can_rig.errors import DbcError
from can_rig.frames.databases import load_database
from tests.helpers import asked
from tests.rig.logs.candump_samples import written
from tests.rig.logs.messages import from_messages

ONE = 'VERSION ""\nBU_: A\nBO_ 256 {name}: 1 A\n SG_ X : 0|8@1+ ({factor},0) [0|0] "" A\n'

J1939 = """\
VERSION ""
BU_: A
BO_ 2565866750 EEC1: 8 A
 SG_ Speed : 24|16@1+ (0.125,0) [0|0] "rpm" A
BO_ 2565800190 TO_ONE: 8 A
 SG_ Y : 0|8@1+ (1,0) [0|0] "" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2565866750 3;
BA_ "VFrameFormat" BO_ 2565800190 3;
"""


def frame(bus: str, identifier: int, data: bytes, extended: bool = False) -> Message:
    return Message(arbitration_id=identifier, is_extended_id=extended, data=data, channel=bus)


def test_four_buses_and_three_databases(tmp_path):
    files = [
        written(tmp_path, ONE.format(name="SAME", factor=factor), f"{factor}.dbc")
        for factor in (1, 2, 3)
    ]
    lines = "".join(f"({at}.0) can{at % 4} 100#{at:02X}\n" for at in range(40))
    log = written(tmp_path, lines + "(50.0) can3 7FF#\n", "a.log")
    out = tmp_path / "a.csv"
    each = [f"can{at}={path}" for at, path in enumerate(files)]
    done = asked("decode", log, "--dbc", each[0], "--dbc", each[1], "--dbc", each[2], "--out", out)
    assert done.returncode == 0, done.stdout
    assert "frames not in the database: 11" in done.stdout  # those of can3
    head, *found = (line.split(",") for line in out.read_text("utf-8").splitlines())
    assert [name.strip('"') for name in head[2:]] == [f"can{at}.SAME.X" for at in range(3)]
    assert [float(row[2 + at % 3]) for at, row in enumerate(found)] == [
        (at % 3 + 1) * (at // 3 * 4 + at % 3) for at in range(30)
    ]
    assert asked("decode", log, "--dbc", f"can9={files[0]}").returncode == 2


def test_a_database_of_one_bus_beside_one_of_all(tmp_path):
    one = load_database(written(tmp_path, ONE.format(name="A", factor=1), "a.dbc"))
    other = load_database(
        written(tmp_path, ONE.format(name="B", factor=1).replace("256", "257"), "b.dbc")
    )
    frames = [frame("x", 256, b"\1"), frame("y", 256, b"\2"), frame("y", 257, b"\3")]
    decoder = Decoder([("x", one), (None, other)])
    found = decoder.decode(from_messages(frames))
    values = {name: columns.signals["X"].tolist() for name, columns in found.items()}
    assert values == {"x.A": [1], "B": [3]}
    assert dict(decoder.unknown) == {"100": 1}
    assert set(Decoder([("x", one), (None, other)], signals=["x.A.X"]).messages) == {"x.A"}
    with pytest.raises(DbcError, match="no message C in the database"):
        Decoder([("x", one)], messages=["C"])


def test_a_parameter_group_whoever_sends_it(tmp_path):
    database = load_database(written(tmp_path, J1939, "a.dbc"))
    data = bytes([0, 0, 0, 0x40, 0x1F, 0, 0, 0])
    frames = [
        frame("0", 0x0CF00400, data, True),  # priority 3, sender 0
        frame("0", 0x18F004FE, data, True),  # as in the database
        frame("0", 0x0CF00417, data, True),
        frame("0", 0x18EF2103, b"\5" + bytes(7), True),  # to 0x21 from 3
        frame("0", 0x18F00500, data, True),  # another group
        frame("0", 0x004, data),
    ]
    decoder = Decoder(database)
    found = decoder.decode(from_messages(frames))
    sources = {name: columns.signals["SourceAddress"].tolist() for name, columns in found.items()}
    assert sources == {"EEC1": [0, 0xFE, 0x17], "TO_ONE": [3]}
    assert found["EEC1"].signals["Speed"].tolist() == [1000.0] * 3
    assert dict(decoder.unknown) == {"18F00500": 1, "004": 1}


@given(st.integers(0, (1 << 29) - 1), st.integers(0, 7), st.integers(0, 255), st.integers(0, 255))
def test_a_group_is_the_identifier_without_priority_and_addresses(identifier, priority, to, source):
    """SAE J1939-21: below PDU format 240 the next byte is an address, from there on it is not."""
    to_one = (identifier >> 16 & 0xFF) < 240
    other = identifier & 0x03FF0000 | priority << 26 | source
    other |= to << 8 if to_one else identifier & 0xFF00
    assert group_key(identifier) == group_key(other)
    assert group_key(identifier) != group_key(identifier ^ 1 << 16)
    if not to_one:
        assert group_key(identifier) != group_key(identifier ^ 1 << 8)


@pytest.mark.parametrize("suffix", [".log", ".blf", ".mf4"])
def test_can_fd_j1939_and_classic_buses_in_one_log(tmp_path, suffix):
    """CAN FD of 64 bytes, J1939 with long messages, a classic bus, and one without a database."""
    fd = 'VERSION ""\nBU_: A\nBO_ 256 LONG: 64 A\n SG_ LAST : 488|24@1- (0.5,1) [0|0] "" A\n'
    files = [
        written(tmp_path, fd, "fd.dbc"),
        written(tmp_path, J1939.replace("EEC1: 8", "EEC1: 30"), "j1939.dbc"),
        written(tmp_path, ONE.format(name="SHORT", factor=3), "classic.dbc"),
    ]
    lines = []
    for at in range(10):
        speed = (at * 100).to_bytes(2, "little").hex()
        packets = [f"0{n + 1}" + "00" * 7 for n in range(5)]
        packets[0] = f"01000000{speed}0000"
        frames = [f"can0 100##1{'00' * 61}{at:02X}0080", f"can2 100#{at:02X}", f"can3 7{at:02X}#"]
        frames += ["can1 1CECFF21#201E0005FF04F000", *(f"can1 1CEBFF21#{p}" for p in packets)]
        lines += [f"({at}.{place:03d}000) {text} R\n" for place, text in enumerate(frames)]
    log = written(tmp_path, "".join(lines), "all.log")
    if suffix != ".log":
        assert asked("convert", log, tmp_path / f"all{suffix}").returncode == 0
        log = tmp_path / f"all{suffix}"
    prefix = "can" if suffix.startswith(".log") else ""
    each = [f"{prefix}{at}={path}" for at, path in enumerate(files)]
    done = asked("decode", log, *(word for one in each for word in ("--dbc", one)), "--json")
    said = json.loads(done.stdout)
    names = [f"{prefix}{at}.{name}" for at, name in enumerate(["LONG", "EEC1", "SHORT"])]
    assert {name: said["messages"][name]["decoded"] for name in names} == dict.fromkeys(names, 10)
    assert said["transport"] == {"messages": 10, "incomplete": 0, "unknown": {}}
    assert sum(said["unknown"].values()) == 10
    databases = [
        (name.split(".")[0], load_database(path)) for name, path in zip(names, files, strict=True)
    ]
    decoded = decode_log(log, databases)
    last = [(at - (1 << 23)) * 0.5 + 1 for at in range(10)]
    assert decoded[names[0]].signals["LAST"].tolist() == last
    assert decoded[names[1]].signals["Speed"].tolist() == [at * 12.5 for at in range(10)]
    assert decoded[names[1]].signals["SourceAddress"].tolist() == [0x21] * 10
    assert decoded[names[2]].signals["X"].tolist() == [at * 3 for at in range(10)]


def test_statistics_name_messages_by_bus_and_parameter_group(tmp_path):
    log = written(tmp_path, "(0.0) can0 0CF00417#00\n(0.1) can1 100#01\n(0.2) can0 100#\n", "a.log")
    one = written(tmp_path, ONE.format(name="SHORT", factor=3), "one.dbc")
    other = written(tmp_path, J1939, "other.dbc")
    done = asked("stats", log, "--dbc", other, "--dbc", f"can1={one}", "--json")
    rows = json.loads(done.stdout)["identifiers"]
    named = {(row["bus"], row["identifier"]): row["message"] for row in rows}
    assert named == {
        ("can0", "0CF00417"): "EEC1",
        ("can1", "100"): "can1.SHORT",
        ("can0", "100"): "",
    }
