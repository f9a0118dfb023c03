"""CSV logs of SavvyCAN and logs of BUSMASTER."""

import csv
from datetime import datetime

import pytest
from hypothesis import given, settings, strategies as st

from can_rig.errors import LogError
from can_rig.logs.frames import EXTENDED, FD, REMOTE, SENT, concatenate
from can_rig.logs.reading import content_format, read_log
from can_rig.logs.writing import write_log
from tests.rig.logs.candump_samples import rows, whole, written
from tests.rig.logs.samples import (
    BUSMASTER_DEC,
    BUSMASTER_HEX,
    GVRET,
    busmaster,
    by_python_can,
    kinds,
    plain,
)


def test_a_savvycan_log(tmp_path):
    path = written(tmp_path, GVRET, "a.csv")
    assert rows(whole(path)) == [
        (39_747_828_000, 0x5EB, 0, "0", 8, bytes.fromhex("E845854B4A283669")),
        (39_747_900_000, 0x18FEF100, EXTENDED | SENT, "1", 3, b"\1\2\3"),
        (39_748_000_000, 0x800, EXTENDED, "0", 0, b""),  # more than 11 bits, whatever it says
    ]
    log = read_log(path)
    assert [len(frames) for frames in log] == [3]
    assert log.start_ns == 39_747_828_000
    old = "".join(
        ",".join(cell for at, cell in enumerate(line.split(",")) if at != 3) + "\n"
        for line in GVRET.splitlines()
    )
    assert [r[:2] + r[3:] for r in rows(whole(written(tmp_path, old, "b.csv")))] == [
        r[:2] + r[3:] for r in rows(whole(path))
    ]


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 1 << 50),
            st.integers(0, (1 << 29) - 1),
            st.booleans(),
            st.integers(0, 255),
            st.binary(max_size=8),
        ),
        min_size=1,
        max_size=20,
    )
)
def test_any_frame_as_the_csv_module_reads_it(tmp_path_factory, frames):
    folder = tmp_path_factory.mktemp("gvret")
    header = GVRET.splitlines()[0]
    lines = [
        f"{time_us},{identifier:08X},{str(identifier > 0x7FF).lower()},{'Tx' if sent else 'Rx'},"
        f"{bus},{len(data)},{','.join(f'{byte:02X}' for byte in data.ljust(8, bytes(1)))},"
        for time_us, identifier, sent, bus, data in frames
    ]
    path = written(folder, "\n".join([header, *lines, ""]), "a.csv")
    with path.open(newline="") as file:
        wanted = [
            (
                int(row["Time Stamp"]) * 1000,
                int(row["ID"], 16),
                EXTENDED * (row["Extended"] == "true") | SENT * (row["Dir"] == "Tx"),
                row["Bus"],
                int(row["LEN"]),
                bytes(int(row[f"D{at + 1}"], 16) for at in range(int(row["LEN"]))).rstrip(b"\0"),
            )
            for row in csv.DictReader(file)
        ]
    assert rows(whole(path)) == wanted


def test_frames_of_more_than_8_bytes_are_can_fd(tmp_path):
    text = GVRET.splitlines()[0] + "\n1,5,false,Rx,0,12," + ",".join(["AA"] * 12) + ",\n"
    assert rows(whole(written(tmp_path, text, "a.csv"))) == [(1000, 5, FD, "0", 12, b"\xaa" * 12)]
    with pytest.raises(LogError, match="line 2: not a valid frame"):  # its other bytes are missing
        whole(written(tmp_path, text.replace(",AA,AA,AA,AA,\n", ",\n"), "a.csv"))


def test_written_for_savvycan(tmp_path):
    source = by_python_can(tmp_path / "a.log", plain(200))
    write_log(read_log(source), tmp_path / "b.csv")
    lines = (tmp_path / "b.csv").read_text("ascii").splitlines()
    assert lines[0] == GVRET.splitlines()[0]
    assert all(line.count(",") == 14 for line in lines[1:])
    for name in ("fd.log", "remote.log"):
        kind = kinds()[2] if name == "fd.log" else kinds()[1]
        other = by_python_can(tmp_path / name, [kind])
        with pytest.raises(
            LogError, match=r"c\.csv: SavvyCAN's CSV holds no error, remote or CAN FD frames, and"
        ):
            write_log(read_log(other), tmp_path / "c.csv")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("39747828,", "nan,", "line 2: not a valid frame|above its first frame is"),
        ("000005EB", "20000000", "line 2: not a valid frame"),
        ("false,Rx,0,8", "maybe,Rx,0,8", "line 2: not a valid frame"),
        ("false,Rx,0,8", "false,Qx,0,8", "line 2: not a valid frame"),
        ("false,Rx,0,8", "false,R\n,0,8", "line 2: not a valid frame"),
        ("false,Rx,0,8", "false,Rx,256,8", "line 2: not a valid frame"),
        ("Rx,0,8,E8", "Rx,0,8,1E8", "line 2: not a valid frame"),
        ("36,69,\n", "36,69 x\n", "line 2: not a valid frame"),
        ("39747900,", "9" * 20 + ",", "line 3: not a valid frame"),
        ("Extended,Dir", "Data", "must be SavvyCAN's Time Stamp,ID,Extended,Dir,Bus,LEN,D1"),
        ("SYSTEM", "RELATIVE", "line 7: each time stamp is the distance to the one before it"),
        ("PROTOCOL CAN", "PROTOCOL J1939", "line 2: a BUSMASTER log of 'J1939'; it must be one of"),
        ("20:11:2013", "32:11:2013", "line 5: not a date: "),
        ("20:11:2013", "1:1:1969", "line 5: not a date: "),
        ("14:19:11:4184", "14:60:11:4184", "line 12: not a valid frame"),
        ("14:19:11:4184", "14:19:11", "line 12: not a valid frame"),
        ("14:19:11:4184", "9999999:19:11:4184", "line 12: not a valid frame"),
        ("14:19:11:4184", "14:19:11:41840000000", "line 12: not a valid frame"),
        ("Tx 1", "Ty 1", "line 12: not a valid frame"),
        ("Tx 1", "Tx 256", "line 12: not a valid frame"),
        ("0x099 s", "0x899 s", "line 12: not a valid frame"),
        ("0x099 s", "0x099 z", "line 12: not a valid frame"),
        (" s 8", " sq 8", "line 12: not a valid frame"),
        (" s 8", " s 65", "line 12: not a valid frame"),
        (" FF ", " FFF ", "line 12: not a valid frame"),
        (" s 8", " s 7", "line 12: not a valid frame"),  # and 8 bytes
        ("14:19:11:4184", "x4:19:11:4184", "line 12: not a valid frame"),
    ],
)
def test_what_is_in_no_such_log_is_named(tmp_path, old, new, said):
    text = GVRET if old in GVRET else busmaster()
    assert old in text
    with pytest.raises(LogError, match=said):
        whole(written(tmp_path, text.replace(old, new, 1), "a.csv"))


def test_a_busmaster_log(tmp_path):
    path = written(tmp_path, busmaster())
    assert content_format(path).key == "BUSMASTER"
    log = read_log(path)
    midnight = round(datetime(2013, 11, 20).timestamp()) * 10**9
    base = midnight + (14 * 3600 + 19 * 60 + 11) * 10**9
    assert rows(concatenate(log)) == [
        (base + 418_400_000, 0x99, SENT, "1", 8, b"\0\1\2\3\4\5\6\xff"),
        (base + 417_400_000, 0x18FEF100, EXTENDED, "2", 2, b"\x0a\x0b"),
        (base + 419_000_000, 0x100, REMOTE, "2", 8, b""),
        (base + 419_000_000, 0x100, EXTENDED | REMOTE, "2", 0, b""),
    ]
    assert log.start_ns == midnight + (14 * 3600 + 19 * 60 + 9) * 10**9 + 538_000_000
    assert log.notice is None


def test_sessions_in_a_row_have_dates_bases_and_modes_of_their_own(tmp_path):
    text = busmaster() + "\n" + busmaster("DEC", "ABSOLUTE", BUSMASTER_DEC, 21)
    path = written(tmp_path, text)
    first, second = (round(datetime(2013, 11, day).timestamp()) * 10**9 for day in (20, 21))
    for chunk in (1, 3, 1000):
        log = read_log(path, chunk)
        *_, last = rows(concatenate(log))
        start_ns = second + (14 * 3600 + 19 * 60 + 10) * 10**9 + 538_000_000
        assert last == (start_ns, 255, 0, "1", 3, b"\0\xff\x10")
        assert log.start_ns == first + (14 * 3600 + 19 * 60 + 9) * 10**9 + 538_000_000


def test_times_of_day_go_on_after_midnight_in_whatever_chunks_they_come(tmp_path):
    times = "23:59:59:9000", "00:00:00:1000", "23:59:59:9500", "09:00:00:0000", "23:00:00:0000"
    lines = "".join(f"{time} Rx 1 0x100 s 0\n" for time in (*times, "00:30:00:0000"))
    midnight = round(datetime(2013, 11, 20).timestamp()) * 10**9
    expected = [86_399.9, 86_400.1, 86_399.95, 33 * 3600, 47 * 3600, 48.5 * 3600]
    for chunk in (1, 2, 4, 1000):
        found = concatenate(read_log(written(tmp_path, busmaster(frames=lines)), chunk))
        assert found.time_ns.tolist() == [midnight + round(each * 1e9) for each in expected]
    undated = busmaster(frames=lines).replace("START DATE", "BEGIN")
    found = concatenate(read_log(written(tmp_path, undated)))
    assert found.time_ns.tolist() == [round(each * 1e9) for each in expected]
    since_the_start = concatenate(
        read_log(written(tmp_path, busmaster(mode="ABSOLUTE", frames=lines)))
    ).time_ns
    assert since_the_start[1] < since_the_start[0]  # counts no days


def test_each_session_counts_midnights_from_its_own_start(tmp_path):
    first = busmaster(frames="00:00:01:0000 Rx 1 0x100 s 0\n").replace(" 14:19:9", " 23:59:9")
    second = busmaster(frames="15:00:00:0000 Rx 1 0x100 s 0\n", day=21)
    found = concatenate(read_log(written(tmp_path, first + "\n" + second)))
    next_day = round(datetime(2013, 11, 21).timestamp()) * 10**9
    assert found.time_ns.tolist() == [next_day + 10**9, next_day + 15 * 3600 * 10**9]


def test_long_frames_of_a_busmaster_log_are_can_fd(tmp_path):
    frame = "00:00:00:0001 Rx 1 0x001 s 12 " + "AB " * 12
    found = whole(written(tmp_path, busmaster(frames=BUSMASTER_HEX + frame)))
    assert rows(found)[-1][1:] == (1, FD, "1", 12, b"\xab" * 12)
