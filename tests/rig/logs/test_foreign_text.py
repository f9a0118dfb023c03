"""Lines of Vector's and PEAK's text logs that other readers stumble over."""

import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import BITRATE_SWITCH, ERROR, ERROR_STATE, EXTENDED, FD, REMOTE, SENT
from can_rig.logs.reading import read_log
from tests.rig.logs.candump_samples import rows, whole, written
from tests.rig.logs.samples import PEAK

PEAK_2_1 = """\
;$FILEVERSION=2.1
;$STARTTIME=43008.5
;$COLUMNS=N,O,T,B,I,d,R,L,D
;
      1         1.000 DT 1      0123 Rx -  2    01 02
      2         2.000 FD 1      0123 Rx -  9    01 02 03 04 05 06 07 08 09 0A 0B 0C
      3         3.500 FB 2  1ABCDEF0 Tx -  15   {}
      4         4.000 BI 1      0123 Rx -  0
      5         5.000 FE 1      0123 Rx -  1    AA
      6         6.000 RR 1      0123 Rx -  4
      7         7.000 ST 1         - Rx -  4    00 00 00 08
      8         8.000 DT 1      0123 Rx -  11   01 02 03 04 05 06 07 08
""".format(" ".join(["5A"] * 64))
ASC = "date Fri Jul 10 06:17:32 2015\nbase hex  timestamps absolute\n"


def test_the_length_code_of_a_peak_trace_is_no_number_of_bytes(tmp_path):
    found = rows(whole(written(tmp_path, PEAK_2_1, "a.trc")))
    start = 43008 - 25569
    base = start * 86400 * 10**9 + 43200 * 10**9
    assert found[0] == (base + 1_000_000, 0x123, 0, "0", 2, b"\1\2")
    assert [(flags, bus, length) for _, _, flags, bus, length, _ in found[1:]] == [
        (FD, "0", 12),
        (FD | BITRATE_SWITCH | SENT | EXTENDED, "1", 64),
        (FD | BITRATE_SWITCH | ERROR_STATE, "0", 0),
        (FD | ERROR_STATE, "0", 1),
        (REMOTE, "0", 4),
        (0, "0", 8),
    ]
    assert found[1][5] == bytes(range(1, 13))
    assert found[2][5] == b"\x5a" * 64


@pytest.mark.parametrize(
    ("version", "line", "bus"),
    [
        ("1.0", "     1)     17535  00000100  2  0A 0B", "0"),
        ("1.1", "     1)     17535.0  Rx     00000100  2  0A 0B", "0"),
        ("1.2", "     1)     17535.000 3  Rx    00000100  2  0A 0B", "2"),
        ("1.3", "     1)     17535.000 3  Rx    00000100 -  2    0A 0B", "2"),
    ],
)
def test_every_version_of_a_peak_trace(tmp_path, version, line, bus):
    text = f";$FILEVERSION={version}\n;$STARTTIME=25569\n;\n{line}\n"
    assert rows(whole(written(tmp_path, text, "a.trc"))) == [
        (17_535_000_000, 0x100, EXTENDED, bus, 2, b"\x0a\x0b")
    ]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("43008.5", "1e999", r"\$STARTTIME=1e999 must be days"),
        ("43008.5", "nan", r"\$STARTTIME=nan must be days"),
        ("43008.5", "99999999999", r"\$STARTTIME=99999999999 must be days"),
        ("1.000 DT", "nan DT", "line 5: not a valid frame"),
        ("1.000 DT", "1e999 DT", "line 5: not a valid frame"),
        ("1.000 DT", "1" * 35 + " DT", "line 5: not a valid frame"),
        ("1.000 DT", "9223372036800.0 DT", "must be before the year 2262"),
        ("     0123 Rx -  2 ", "1FFFFFFFFFFFFFFFF Rx -  2 ", "line 5: not a valid frame"),
        ("0123 Rx -  2 ", "0123 Rx -  2147483648 ", "line 5: not a valid frame"),
        ("0123 Rx -  2 ", "0123 Rx -  16 ", "line 5: not a valid frame"),
        (" 2    01 02\n", " 2    01\n", "line 5: not a valid frame"),
        (" 2    01 02\n", " 2    0G 02\n", "line 5: not a valid frame"),
        ("2.1", "3.0", None),  # it names its columns
        (",L,D", ",D", "must be of version 1.0 to 1.3, or name its columns"),
    ],
)
def test_numbers_beyond_any_range_in_a_peak_trace(tmp_path, old, new, said):
    path = written(tmp_path, PEAK_2_1.replace(old, new, 1), "a.trc")
    if said is None:
        assert len(whole(path)) == 7
        return
    with pytest.raises(LogError, match=said):
        whole(path)


@pytest.mark.parametrize(
    "line",
    ["99999999999999999999.5 1  123  Rx   d 1 00", "1.0 1  100000000  Rx   d 1 00",
     "1.0 1  1FFFFFFFFFFFFFFFFx  Rx   d 1 00", "1.0 1  800  Rx   d 1 00", "1.0 0  123  Rx   d 1 00",
     "1.0 300  123  Rx   d 1 00", "1.0 1  123  Rx   d 2147483648 00", "1.0 1  123  Rx   d 2 00",
     "1.0 1  123  Rx   d 1 100", "1.0 1  123  Rx   d 1 0G", "1.0 1  1G3x  Rx   d 1 00",
     "1.0 CANFD 1 Rx  123  1 0 9 65 00", "1.0 CANFD 1 Rx  123  1 0", "1.0 CANFD 1 Rx"],
)  # fmt: skip
def test_numbers_beyond_any_range_in_a_vector_log(tmp_path, line):
    path = written(tmp_path, f"{ASC}0.5 1  123  Rx   d 1 00\n{line}\n", "a.asc")
    with pytest.raises(LogError, match="line 4: not a valid frame"):
        whole(path)


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("1.0 CANFD 3 Tx 123 0 1 5 0 140000 73 200050 7a60 0", (REMOTE | SENT, 5, b"")),
        ("1.0 CANFD 3 Tx 123 0 0 5 0", (REMOTE | SENT, 5, b"")),
        ("1.0 CANFD 3 Rx 123 Name 0 0 1 1 AA 140000 73 200000 7a60", (0, 1, b"\xaa")),
        ("1.0 CANFD 3 Rx 123 Name 0 0 1 1 AA 140000 73 201000 7a60", (FD, 1, b"\xaa")),
        ("1.0 CANFD 3 Rx 123 1 0 1 1 AA", (FD | BITRATE_SWITCH, 1, b"\xaa")),
        ("1.0 CANFD 3 Rx ErrorFrame Not Acknowledge", (FD | ERROR, 0, b"")),
        ("1.0 3 123 Rx d 9 01 02 03 04 05 06 07 08", (0, 8, bytes(range(1, 9)))),
        ("1.0 3 ErrorFrame ECC: 10100010", (ERROR, 0, b"")),
    ],
)
def test_kinds_of_frames_of_a_vector_log(tmp_path, line, kind):
    """Remote frames are classic ones, and so is what a controller for CAN FD received as such."""
    (found,) = rows(whole(written(tmp_path, f"{ASC}{line}\n", "a.asc")))
    assert (found[2], *found[4:]) == kind
    assert found[3] == "2"


@pytest.mark.parametrize(("name", "text", "line"), [("a.asc", ASC, 5), ("a.trc", PEAK, 9)])
def test_a_second_log_in_a_file_is_refused(tmp_path, name, text, line):
    """The times of its frames count from another start."""
    first = text if name == "a.trc" else f"{ASC}1.0 1 123 Rx d 1 05\n1.5 1 123 Rx d 1 05\n"
    path = written(tmp_path, first + first, name)
    with pytest.raises(LogError, match=rf"{name}: line {line}: a second log begins here"):
        whole(path)


@pytest.mark.parametrize("year", ["0001", "9999", "99999"])
def test_a_date_that_is_none_of_a_recording_is_passed_over(tmp_path, year):
    text = ASC.replace("2015", year) + "1.0 1 123 Rx d 1 05\n"
    assert rows(whole(written(tmp_path, text, "a.asc"))) == [(10**9, 0x123, 0, "0", 1, b"\5")]


def test_decimal_numbers_of_a_vector_log(tmp_path):
    text = "base dec  timestamps absolute\n1.0 1 300x Rx d 3 10 255 0\n"
    (found,) = rows(whole(written(tmp_path, text, "a.asc")))
    assert found[1:] == (300, EXTENDED, "0", 3, b"\x0a\xff")  # the zero at the end is stripped


@pytest.mark.parametrize("name", ["a.asc", "a.trc", "a.log"])
def test_a_last_line_that_says_its_length_needs_no_newline(tmp_path, name):
    text, length = {
        "a.asc": (f"{ASC}0.5 1  123  Rx   d 1 00\n0.6 1  124  Rx   d 2 0A 0B", 2),
        "a.trc": (PEAK_2_1[: PEAK_2_1.index("\n      7")], 4),
        "a.log": ("(1.0) can0 1#\n(2.0) can0 1#0102030405060708", 8),
    }[name]
    log = read_log(written(tmp_path, text, name))
    frames = [frame for chunk in log for frame in rows(chunk)]
    assert frames[-1][4] == length
    assert log.notice is None
    log = read_log(written(tmp_path, text[:-1], name))
    cut = [frame for chunk in log for frame in rows(chunk)]
    assert log.notice is not None
    assert cut == frames[:-1]
