"""Databases that break conventions: duplicate names, signals outside, unbounded lengths."""

import resource
from pathlib import Path

import pytest
from can import Message

from can_rig.decoding.decode import Decoder
from can_rig.errors import DbcError
from can_rig.frames.databases import load_database
from tests.helpers import DBC, rig, succeeded
from tests.rig.decoding.databases import require_agreement
from tests.rig.logs.messages import from_messages

TWICE = """\
VERSION ""
BU_: A
BO_ 256 SAME: 2 A
 SG_ X : 0|8@1+ (1,0) [0|0] "" A
BO_ 257 SAME: 2 A
 SG_ X : 0|16@1+ (2,0) [0|0] "" A
BO_ 258 OTHER: 1 A
 SG_ Z : 0|8@1+ (1,0) [0|0] "" A
"""
OUTSIDE = """\
VERSION ""
BU_: A
BO_ 256 ONE: 2 A
 SG_ IN : 0|8@1+ (1,0) [0|0] "" A
 SG_ OUT : 12|16@1+ (1,0) [0|0] "" A
BO_ 257 MULTIPLEXED: 2 A
 SG_ M M : 12|8@1+ (1,0) [0|0] "" A
 SG_ S m1 : 0|8@1+ (1,0) [0|0] "" A
"""


def frame(identifier: int, data: bytes) -> Message:
    return Message(arbitration_id=identifier, is_extended_id=False, data=data)


def written(folder: Path, text: str, name: str = "a.dbc") -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize("strict", [True, False])
def test_a_dbc_of_another_encoding_is_loaded(tmp_path, strict):
    """In UTF-8, with its mark or without, in that of Windows, and with a byte that neither has."""
    text = TWICE.replace('"" A', '"\u00b0/s" A', 1).encode()
    path = tmp_path / "a.dbc"
    windows, neither = text.replace(b"\xc2", b""), text.replace(b"\xb0", b"\x81")
    for found, unit in (
        (text, "\u00b0/s"),
        (b"\xef\xbb\xbf" + text, "\u00b0/s"),
        (windows, "\u00b0/s"),
        (neither.replace(b"\xc2\x81", b"\xff\x81"), "\u00ff\ufffd/s"),
    ):
        path.write_bytes(found)
        messages = load_database(path, strict).messages
        assert [message.frame_id for message in messages] == [256, 257, 258]
        assert {signal.unit for message in messages for signal in message.signals} - {None} == {
            unit
        }


def test_two_messages_of_one_name_are_two_messages(tmp_path):
    database = load_database(written(tmp_path, TWICE))
    frames = [frame(256, b"\5\0"), frame(257, b"\7\1"), frame(258, b"\1"), frame(256, b"\6\0")]
    decoder = Decoder(database)
    found = decoder.decode(from_messages(frames))
    columns = {name: columns.signals for name, columns in found.items()}
    assert {n: {s: v.tolist() for s, v in c.items()} for n, c in columns.items()} == {
        "SAME_100": {"X": [5, 6]},
        "SAME_101": {"X": [2 * 0x107]},
        "OTHER": {"Z": [1]},
    }
    assert [decoder.counts[name].decoded for name in found] == [2, 1, 1]
    assert [c.name for c in found.values()] == list(found)


@pytest.mark.parametrize(
    ("wanted", "found"),
    [({"messages": ["SAME"]}, {"SAME_100", "SAME_101"}), ({"messages": ["SAME_101"]}, {"SAME_101"}),
     ({"signals": ["SAME.X"]}, {"SAME_100", "SAME_101"}),
     ({"signals": ["SAME_100.X"]}, {"SAME_100"}), ({"signals": ["X"]}, {"SAME_100", "SAME_101"})],
)  # fmt: skip
def test_either_name_may_be_asked_for(tmp_path, wanted, found):
    assert set(Decoder(load_database(written(tmp_path, TWICE)), **wanted).messages) == found


def test_a_signal_outside_its_message_is_left_out_alone(tmp_path):
    path = written(tmp_path, OUTSIDE)
    with pytest.raises(DbcError, match="does not fit"):
        load_database(path)
    decoder = Decoder(load_database(path, strict=False))
    assert decoder.left_out == ["ONE.OUT", "MULTIPLEXED.S", "MULTIPLEXED.M"]
    found = decoder.decode(from_messages([frame(256, b"\5\0"), frame(257, b"\1\0")]))
    assert {name: list(columns.signals) for name, columns in found.items()} == {
        "ONE": ["IN"],
        "MULTIPLEXED": [],
    }
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 100#0500\n", "ascii")
    done = succeeded("decode", log, "--dbc", path, "--no-strict")
    assert "note: ONE.OUT does not lie within its message" in done.stderr


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("0|8@1+ (1,0)", "0|2147483648@1+ (1,0)", 4),
        ("0|8@1+ (1,0)", "2147483648|8@1+ (1,0)", 4),
        ("257 SAME: 2", "257 SAME: 2147483648", 5),
        ("257 SAME: 2", "257 SAME: 65536", 5),  # took half a minute
    ],
)
@pytest.mark.parametrize("strict", [True, False])
def test_a_length_beyond_any_frame_takes_no_memory(tmp_path, old, new, line, strict):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(
        DbcError, match=rf"a.dbc: line {line}: a place or length of (2147483648|65536); "
    ):
        load_database(written(tmp_path, TWICE.replace(old, new)), strict)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 18


UDS = """\
VERSION ""
BU_: A
BO_ 2028 UDS: 8 A
 SG_ S M : 15|8@0+ (1,0) [0|0] "" A
 SG_ R m98M : 23|16@0+ (1,0) [0|0] "" A
 SG_ Pressure m49163 : 39|8@0+ (0.2,0) [0|0] "psi" A
 SG_ Serial m0 : 47|16@0+ (1,0) [0|0] "" A
SG_MUL_VAL_ 2028 R S 98-98;
SG_MUL_VAL_ 2028 Pressure R 49163-49163;
SG_MUL_VAL_ 2028 Serial R 61840-61845, 65535-65535;
"""


def test_multiplexers_of_16_bits(tmp_path):
    """As UDS has them: a service, and below it an identifier of data."""
    database = load_database(written(tmp_path, UDS))
    identifiers = [49163, 61840, 61843, 61845, 61846, 65535, 0]
    payloads = [b"\7\x62" + number.to_bytes(2, "big") + b"\1\2\3\4" for number in identifiers]
    payloads += [b"\3\x7f\x22\x31\0\0\0\0", payloads[0][:5], payloads[1][:6], payloads[0][:3]]
    require_agreement(database, [(database.messages[0], payload) for payload in payloads])


@pytest.mark.parametrize(
    "values", ["49163-4294967295", "0-99999999999", "0-65535, 0-65535,\n 0-65535, 0-65535, 0-99"]
)
def test_more_values_of_a_multiplexer_than_can_be_listed(tmp_path, values):
    line = 9 + values.count("\n")
    with pytest.raises(DbcError, match=rf"a.dbc: line {line}: with .* more than 262144 values"):
        load_database(written(tmp_path, UDS.replace("49163-49163", values)))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [("SG_ Z :", "SG_ 2Z :", "line 8, column 6: '2Z .*': a name must begin with a letter or an"),
     ("258 OTHER", "258 3OTHER", "line 7, column 9: '3OTHER.*': a name must begin with"),
     ("(2,0)", "(.5,0)", r"line 6, column 19: '\.5.*': a number must have a digit before its"),
     ("BO_ 258", 'CM_ 257 "x";\nBO_ 258', "line 7, column 5: '257 .*': BO_ must stand before"),
     ("BO_ 258", 'CM_ SG_ 257 "x";\nBO_ 258', "line 7, column 13: .* the name of the signal is"),
     ("BO_ 258", 'CM_ "x"\n\nBO_ 258', "line 7: 'CM_ \"x\"' must end with a semicolon"),
     ("BO_ 258", 'CM_ "x;\nCM_ "y, z";\nBO_ 258', "line 7: 'CM_ \"x;' must have quotation marks"),
     ("BO_ 258", 'CM_ "a\nb";\nCM_ "x;\nBO_ 258', "line 9: 'CM_ \"x;' must have quotation marks"),
     ("BO_ 258", "BO_ 2147483647", "line 7: .*more than 11 bits in message OTHER.*must be at most"),
     ("BO_ 258", "}\nBO_ 258", "line 7, column 1: '}': a DBC cannot have this here"),
     (" SG_ Z : 0", 'VAL_ 9 Q 1 "a"\n 2 "b" ;\n SG_ Z : .0', "line 10, column 10: '.0")],
)  # fmt: skip
@pytest.mark.parametrize("strict", [True, False])
def test_what_cannot_be_loaded_is_said_with_its_line(tmp_path, old, new, said, strict):
    """Found in opendbc; the last one has lines that are left out."""
    with pytest.raises(DbcError, match=f"a.dbc: .*: {said}"):
        load_database(written(tmp_path, TWICE.replace(old, new)), strict)


def test_a_value_table_without_its_signal_is_said_with_its_line(tmp_path):
    path = written(tmp_path, TWICE + 'VAL_ 257 Q 1 "a" ;\n')
    line = TWICE.count("\n") + 1
    with pytest.raises(DbcError, match=f"line {line}: unused VAL_.* must be in the message"):
        load_database(path)
    assert load_database(path, strict=False).messages


def test_signals_without_a_place_or_a_name(tmp_path):
    """Found by tools/fuzz: a signal behind no multiplexer, one without a name, and others."""
    text = TWICE.replace(" SG_ Z : 0|8", " SG_ Z m3 : 0|8")
    decoder = Decoder(load_database(written(tmp_path, text), strict=False))
    decoder.decode(from_messages([frame(258, b"\1")]))
    kcd = (
        '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/><Bus name="B">'
        '<Message id="0x100" name="One" length="8"><Signal offset="0" length="8"/></Message></Bus>'
        "</NetworkDefinition>"
    )
    with pytest.raises(DbcError, match="message 0x100 or a signal of it has no name"):
        load_database(written(tmp_path, kcd, "a.kcd"))


def test_a_database_is_known_by_what_is_in_it(tmp_path):
    text = (DBC / "steer_by_wire.dbc").read_text("utf-8")
    assert len(load_database(written(tmp_path, text, "dbc.sym")).messages) == 11
    sym = (
        'FormatVersion=6.0 // Do not edit this line!\nTitle="t"\n\n{SENDRECEIVE}\n\n'
        "[One]\nID=100h\nLen=8\nVar=X unsigned 0,8\n"
    )
    database = load_database(written(tmp_path, sym, "sym.dbc"))
    assert [(m.name, m.frame_id) for m in database.messages] == [("One", 0x100)]
    kcd = (
        '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/>'
        '<Bus name="B"><Message id="0x100" name="One" length="8"/></Bus></NetworkDefinition>'
    )
    assert load_database(written(tmp_path, kcd, "kcd")).messages[0].name == "One"
    with pytest.raises(DbcError, match="cannot be loaded"):
        load_database(written(tmp_path, "<AUTOSAR>", "a.dbc"))


def test_no_library_prints_beside_the_command(tmp_path):
    """cantools warns of two messages with one identifier."""
    path = written(tmp_path, TWICE.replace("257 SAME", "256 SAME"))
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 100#0500\n", "ascii")
    done = rig("decode", log, "--dbc", path)
    assert (done.returncode, done.stderr) == (0, "")


NAMED_ALIKE = """\
VERSION ""
BU_: A
BO_ 256 ONE: 3 A
 SG_ A : 0|8@1+ (1,0) [0|0] "" A
 SG_ B : 8|8@1+ (1,0) [0|0] "" A
 SG_ C : 16|8@1+ (1,0) [0|0] "" A
BA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;
BA_DEF_DEF_ "SystemSignalLongSymbol" "";
BA_ "SystemSignalLongSymbol" SG_ 256 A "Lock State";
BA_ "SystemSignalLongSymbol" SG_ 256 B "Lock State";
"""
UNMARKED = """\
VERSION ""
BU_: A
BO_ 107135027 LEFT: 1 A
 SG_ X : 0|8@1+ (2,0) [0|0] "" A
BO_ 256 SHORT: 1 A
 SG_ X : 0|8@1+ (1,0) [0|0] "" A
CM_ BO_ 107135027 "an identifier of 29 bits without the mark of one";
BA_DEF_ SG_ "GenSigStartValue" INT 0 255;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenSigStartValue" SG_ 107135027 X 3;
VAL_ 107135027 X 1 "one; two" 2 "two" ;
VAL_ 256 GONE 1 "one" ;
VAL_ 999 X 1 "one" ;
VAL_ 256 X 1 "on" ;
"""


def test_two_signals_of_one_name_are_two_signals(tmp_path):
    """As in canmatrix's j1939.dbc, whose long names are the same where the short ones are not."""
    path = written(tmp_path, NAMED_ALIKE)
    with pytest.raises(DbcError, match="Lock State and Lock State are overlapping"):
        load_database(path)  # cantools reads the signals this way
    decoder = Decoder(load_database(path, strict=False))
    found = decoder.decode(from_messages([frame(256, b"\1\2\3")]))
    values = {name: column.tolist() for name, column in found["ONE"].signals.items()}
    assert values == {"Lock State_0": [1], "Lock State_8": [2], "C": [3]}


def test_a_dbc_as_opendbc_has_them(tmp_path):
    """Extended identifiers without bit 31, and value tables of signals that there are not."""
    path = written(tmp_path, UNMARKED)
    with pytest.raises(DbcError, match="more than 11 bits"):
        load_database(path)
    database = load_database(path, strict=False)
    left = database.get_message_by_name("LEFT")
    assert (left.frame_id, left.is_extended_frame) == (107135027, True)
    assert left.comment == "an identifier of 29 bits without the mark of one"
    assert left.get_signal_by_name("X").raw_initial == 3
    assert dict(left.get_signal_by_name("X").choices) == {1: "one; two", 2: "two"}
    decoder = Decoder(database)
    long = Message(arbitration_id=107135027, is_extended_id=True, data=b"\4")
    found = decoder.decode(from_messages([long, frame(256, b"\1")]))
    assert found["LEFT"].signals["X"].tolist() == [8]
    assert found["SHORT"].words("X").tolist() == ["on"]
