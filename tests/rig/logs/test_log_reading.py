"""Logs of other formats and other programs: read whole, or refused, or their missing end noted."""

from __future__ import annotations

import gzip
import os
import time
from pathlib import Path

import asammdf
import can
import numpy as np
import pytest
from asammdf import Signal, Source
from can import Message

from can_rig.errors import LogError
from can_rig.logs.frames import (
    ERROR,
    EXTENDED,
    FD,
    REMOTE,
    SENT,
    Frames,
    concatenate,
    from_messages,
)
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log

START_S = 1_700_000_000.25


@pytest.fixture(autouse=True, scope="module")
def a_time_zone():
    """ASC has local time: one that is not UTC, so that a mix-up shows."""
    before = os.environ.get("TZ")
    os.environ["TZ"] = "America/St_Johns"
    time.tzset()
    yield
    if before is None:
        del os.environ["TZ"]
    else:
        os.environ["TZ"] = before
    time.tzset()


def plain(count: int, start_s: float = START_S) -> list[Message]:
    """Classic data frames, one every 0.1 to 1 ms, of two buses."""
    random = np.random.default_rng(1)
    times = start_s + np.cumsum(random.integers(100, 1000, count)) * 1e-6
    extended = random.integers(0, 2, count)
    return [
        Message(
            timestamp=float(stamp),
            arbitration_id=int(random.integers(0, 1 << 29)) if extended[at] else at % 0x7FF,
            is_extended_id=bool(extended[at]),
            data=random.bytes(int(random.integers(0, 9))),
            channel=int(random.integers(0, 2)),
            is_rx=bool(at % 3),
        )
        for at, stamp in enumerate(times)
    ]


def kinds() -> list[Message]:
    """One frame of every kind."""
    common = {"channel": 1, "is_extended_id": False}
    return [
        Message(START_S, 0x123, data=b"\1\2\3", **common),
        Message(START_S + 0.001, 0x123, is_remote_frame=True, dlc=5, **common),
        Message(START_S + 0.002, 0x7FF, is_fd=True, data=bytes(range(48)), **common),
        Message(START_S + 0.003, 0x7FE, is_fd=True, bitrate_switch=True, data=b"\1", **common),
        Message(START_S + 0.004, is_error_frame=True, channel=1),
        Message(START_S + 0.005, 0x1234567, data=bytes(8), channel=1, is_rx=False),
    ]


def by_python_can(path: Path, messages: list[Message]) -> Path:
    with can.Logger(path) as logger:
        for message in messages:
            logger.on_message_received(message)
    return path


def content(frames: Frames) -> list[tuple]:
    """What every format keeps of a frame, buses by their numbers apart."""
    return [
        (
            0 if frames.flags[at] & ERROR else int(frames.arbitration_id[at]),
            int(frames.flags[at]) & ~(EXTENDED if frames.flags[at] & ERROR else 0),
            int(frames.length[at]),
            frames.data[at].tobytes().rstrip(b"\0"),
        )
        for at in range(len(frames))
    ]


def relative_ns(frames: Frames) -> np.ndarray:
    return frames.time_ns - frames.time_ns[0]


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".mf4"])
def test_what_python_can_wrote(tmp_path: Path, suffix: str) -> None:
    messages = plain(300)
    log = read_log(by_python_can(tmp_path / f"a{suffix}", messages), chunk_frames=64)
    frames, sent = concatenate(log), from_messages(messages)
    assert content(frames) == content(sent)
    assert abs(relative_ns(frames) - relative_ns(sent)).max() <= 1000
    assert abs(frames.time_ns - sent.time_ns).max() <= 1_000_000  # ASC's header: milliseconds
    numbers = np.array([int(name) for name in frames.channels])[frames.channel]
    bus = np.array([message.channel for message in messages])
    assert (numbers - bus == numbers[0] - bus[0]).all()  # PEAK counts them from 1
    assert log.notice is None
    assert log.fraction == 1.0


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".mf4"])
def test_every_kind_of_frame(tmp_path: Path, suffix: str) -> None:
    log = read_log(by_python_can(tmp_path / f"a{suffix}", kinds()))
    assert content(concatenate(log)) == content(from_messages(kinds()))


@pytest.mark.parametrize("suffix", [".asc", ".trc"])
def test_compressed_text(tmp_path: Path, suffix: str) -> None:
    path = by_python_can(tmp_path / f"a{suffix}", plain(50))
    (tmp_path / f"a{suffix}.gz").write_bytes(gzip.compress(path.read_bytes()))
    unpacked, packed = read_log(path), read_log(tmp_path / f"a{suffix}.gz")
    assert content(concatenate(packed)) == content(concatenate(unpacked))
    assert packed.start_ns == unpacked.start_ns > 0


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".blf", ".mf4", ".asc", ".trc"])
@pytest.mark.parametrize("start_s", [0.0, 5.5, START_S])
def test_written_and_read_again(tmp_path: Path, suffix: str, start_s: float) -> None:
    by_python_can(tmp_path / "a.log", plain(200, start_s))
    first = concatenate(read_log(tmp_path / "a.log"))
    write_log(read_log(tmp_path / "a.log", chunk_frames=33), tmp_path / f"b{suffix}")
    again = concatenate(read_log(tmp_path / f"b{suffix}"))
    assert content(again) == content(first)
    assert abs(relative_ns(again) - relative_ns(first)).max() <= 1000 * (suffix in {".asc", ".trc"})
    if suffix not in {".asc", ".trc"}:
        assert (again.time_ns == first.time_ns).all()
    assert not list(tmp_path.glob(".part*"))


@pytest.mark.parametrize("suffix", [".log", ".blf", ".mf4"])
def test_every_kind_of_frame_written(tmp_path: Path, suffix: str) -> None:
    text = (
        "(1700000000.000000) can1 123#R5 R\n"
        f"(1700000000.000001) can1 7FF##3{'AB' * 48} T\n"
        "(1700000000.000002) can1 20000088#0000080000000000 R\n"
        "(1700000000.000003) can1 1234567A#DEAD R\n"
    )
    (tmp_path / "a.log").write_text(text, "ascii")
    write_log(read_log(tmp_path / "a.log"), tmp_path / f"b{suffix}")
    frames = concatenate(read_log(tmp_path / f"b{suffix}"))
    expected = concatenate(read_log(tmp_path / "a.log"))
    assert content(frames) == content(expected)
    if suffix == ".mf4":
        assert frames.arbitration_id.tolist() == expected.arbitration_id.tolist()
    if suffix == ".log":
        assert (tmp_path / "b.log").read_text("ascii") == text


def test_a_peak_log_tells_its_own_name(tmp_path: Path) -> None:
    by_python_can(tmp_path / "a.log", plain(2))
    write_log(read_log(tmp_path / "a.log"), tmp_path / "b.trc")
    assert f";   {tmp_path / 'b.trc'}" in (tmp_path / "b.trc").read_text("ascii").splitlines()


def test_a_peak_log_holds_only_data_frames(tmp_path: Path) -> None:
    by_python_can(tmp_path / "a.blf", kinds())
    with pytest.raises(LogError, match=r"b.trc: .* 4 frames of .*a.blf are not; "):
        write_log(read_log(tmp_path / "a.blf"), tmp_path / "b.trc")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.blf"]


# Other programs' files.

_FD = " 130000  130     {}000 0 0 0 0 0"
LOG2ASC = f"""\
date Fri Jul 10 06:17:32 2015
base hex  timestamps absolute
no internal events logged
   0.000000 1  44              Rx   d 5 2A 36 6C 2B BA
   0.400291 1  12345678x       Rx   r 0
   1.000857 CANFD   1 Rx        5A1                          0 0 0  0  {_FD.format(1)}
   1.201412 CANFD   1 Tx        5A1                          1 1 2 2 11 22 {_FD.format(7)}
   1.401516 1  ErrorFrame
"""

CANOE = """\
date Sam Sep 30 15:06:13.191 2017
base hex  timestamps absolute
internal events logged
// version 9.0.0
Begin Triggerblock Sat Sep 30 15:06:13.191 2017
   0.000000 Start of measurement
   0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0
   0.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
   1.000000 1  123             Rx   d 2 0A 0B  Length = 0 BitCount = 64 ID = 291
   2.501000 2  1F334455x       Tx   d 1 FF
   3.000000 J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40 1F DE 80 25 D0 07 60 27 00
   3.148421 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
End TriggerBlock
"""

PEAK = """\
;$FILEVERSION=1.1
;$STARTTIME=43474.7110516666
;
;   Message Number
     1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00
     2)      1065.5  Tx     00000300  8  00 00 00 00 00 00 00 01
     3)      1283.2  Warng  FFFFFFFF  4  00 00 00 04 -- -- -- -- BUSLIGHT
     4)      1298.9  Rx         0400  2  RTR
"""


def test_a_log_of_log2asc(tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(LOG2ASC, "ascii")
    log = read_log(tmp_path / "a.asc")
    frames = concatenate(log)
    assert [flags & ~EXTENDED if flags & ERROR else flags for flags in frames.flags.tolist()] == [
        0,
        EXTENDED | REMOTE,
        FD,
        FD | SENT | 16 | 32,
        ERROR,
    ]
    since_ns = (frames.time_ns - log.start_ns).tolist()
    assert since_ns == [0, 400_291_000, 1_000_857_000, 1_201_412_000, 1_401_516_000]
    assert log.start_ns == time.mktime((2015, 7, 10, 6, 17, 32, 0, 0, -1)) * 1_000_000_000
    assert log.notice is None


def test_a_log_of_canoe(tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(CANOE, "ascii")
    log = read_log(tmp_path / "a.asc")
    assert content(concatenate(log)) == [
        (0x123, 0, 2, b"\x0a\x0b"),
        (0x1F334455, EXTENDED | SENT, 1, b"\xff"),
    ]
    begun_s = time.mktime((2017, 9, 30, 15, 6, 13, 0, 0, -1)) + 0.191
    assert log.start_ns == round(begun_s * 1000) * 1_000_000
    assert log.notice is None


def test_the_first_frame_behind_a_short_header_is_read(tmp_path: Path) -> None:
    """python-can takes the line behind the header for one of it."""
    text = LOG2ASC.replace("no internal events logged\n", "")
    (tmp_path / "a.asc").write_text(text, "ascii")
    assert len(concatenate(read_log(tmp_path / "a.asc"))) == 5


def test_time_stamps_from_line_to_line_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(LOG2ASC.replace("absolute", "relative"), "ascii")
    with pytest.raises(LogError, match=r"a.asc: .*'timestamps relative'.*absolute"):
        concatenate(read_log(tmp_path / "a.asc"))


def test_a_log_of_pcan_view(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text(PEAK, "ascii")
    log = read_log(tmp_path / "a.trc")
    frames = concatenate(log)
    assert content(frames) == [
        (0x300, 0, 7, bytes.fromhex("0000000004")),
        (0x300, EXTENDED | SENT, 8, bytes.fromhex("0000000000000001")),
        (0x400, REMOTE, 2, b""),
    ]
    assert (frames.time_ns - log.start_ns).tolist() == [1_059_900_000, 1_065_500_000, 1_298_900_000]
    assert abs(log.start_ns - round((43474.7110516666 - 25569) * 86400e9)) <= 1000


def bus_logging(path: Path, groups: int) -> Path:
    """A file as asammdf makes it from columns, its frames dealt out to groups."""
    with asammdf.MDF(version="4.11") as file:
        for group in range(groups):
            times = (np.arange(30) * 0.01)[group::groups]
            count = len(times)
            members = {
                "BusChannel": np.full(count, group + 1, np.uint8),
                "ID": (np.arange(count) + 0x100 * group + (1 << 31) * (group == 1)),
                "DLC": np.full(count, 4, np.uint8),
                "DataLength": np.full(count, 4, np.uint8),
                "DataBytes": np.tile(np.arange(8, dtype=np.uint8), (count, 1)),
                "Dir": np.ones(count, np.uint8),
            }
            members["ID"] = members["ID"].astype(np.uint32)
            names = {f"CAN_DataFrame.{name}": values for name, values in members.items()}
            records = np.zeros(count, [(n, v.dtype, v.shape[1:]) for n, v in names.items()])
            for name, values in names.items():
                records[name] = values
            source = Source("CAN", "", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
            file.append(Signal(records, times, name="CAN_DataFrame", source=source))
        file.save(path)
    return path


@pytest.mark.parametrize("groups", [1, 2, 3])
@pytest.mark.parametrize("chunk_frames", [4, 100])
def test_groups_are_merged_by_time(tmp_path: Path, groups: int, chunk_frames: int) -> None:
    log = read_log(bus_logging(tmp_path / "a.mf4", groups), chunk_frames)
    frames = concatenate(log)
    assert relative_ns(frames).tolist() == [at * 10_000_000 for at in range(30)]
    for group in range(groups):
        of_group = frames[group::groups]
        expected = [0x100 * group + at for at in range(len(of_group))]
        assert of_group.arbitration_id.tolist() == expected
        assert (of_group.has(EXTENDED) == (group == 1)).all()
    assert frames.has(SENT).all()
    assert (frames.data == np.arange(8)).all()


# Cut off, damaged, something else.


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc"])
def test_cut_off_at_every_byte(tmp_path: Path, suffix: str) -> None:
    """All frames up to the cut and a notice, or one line where not even the header is left."""
    path = by_python_can(tmp_path / f"a{suffix}", plain(6))
    data = path.read_bytes()
    every = content(concatenate(read_log(path)))
    most = 0
    for cut in range(1, len(data)):
        path.write_bytes(data[:cut])
        log = read_log(path)
        try:
            found = content(concatenate(log))
        except LogError as error:
            assert str(error).startswith(str(path))
            assert "\n" not in str(error)
            assert most == 0
            continue
        assert found == every[: len(found)]
        assert len(found) >= most  # a longer file never gives less
        most = len(found)
        between_lines = suffix != ".blf" and not data[:cut].rpartition(b"\n")[2].strip()
        between_lines |= data[cut - 1 : cut] == b"\r"
        if log.notice is None:
            assert between_lines or not data[cut:].strip()
        else:
            assert "\n" not in log.notice
    assert most >= (0 if suffix == ".blf" else 5)  # the only container of this BLF is cut


def test_a_cut_off_mdf_file_is_read_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mf4"
    by_python_can(tmp_path / "a.log", plain(40))
    write_log(read_log(tmp_path / "a.log"), path)
    data = path.read_bytes()
    every = content(concatenate(read_log(path)))
    for cut in [*range(0, len(data), 211), len(data) - 1]:
        path.write_bytes(data[:cut])
        try:
            assert content(concatenate(read_log(path))) == every
        except LogError as error:
            assert str(error).startswith(str(path))
            assert "\n" not in str(error)
            assert cut == 0 or "MDF 4 file that is cut off or damaged" in str(error)
    path.write_bytes(b"MDF     3.30" + data[12:100])
    with pytest.raises(LogError, match=r"a\.mf4: not an MDF file that asammdf can read"):
        concatenate(read_log(path))


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".mf4"])
@pytest.mark.parametrize(
    "junk", [b"this is\nno log\nat all\n", bytes(500), np.random.default_rng(2).bytes(3000)]
)
def test_something_else_is_refused_in_one_line(tmp_path: Path, suffix: str, junk: bytes) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(junk)
    with pytest.raises(LogError) as error:
        concatenate(read_log(path))
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (LOG2ASC.replace("12345678x", "1234G678x"), 5),
        (LOG2ASC.replace("2A 36", "2A 3G"), 4),
    ],
)
def test_a_damaged_frame_of_a_vector_log_is_named(tmp_path: Path, text: str, line: int) -> None:
    """python-can passes over it in silence."""
    (tmp_path / "a.asc").write_text(text, "ascii")
    with pytest.raises(LogError, match=rf"a.asc: line {line}: "):
        concatenate(read_log(tmp_path / "a.asc"))


def test_a_damaged_frame_of_a_peak_log_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text(PEAK.replace("8  00 00", "8  0G 00"), "ascii")
    with pytest.raises(LogError, match=r"a.trc: line 6: "):
        concatenate(read_log(tmp_path / "a.trc"))


def test_a_damaged_binary_log_is_named(tmp_path: Path) -> None:
    path = by_python_can(tmp_path / "a.blf", plain(50))
    data = bytearray(path.read_bytes())
    data[144 + 40 : 144 + 60] = bytes(20)
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"a.blf: byte \d+: does not follow the format"):
        concatenate(read_log(path))


def test_a_binary_log_that_was_never_finished(tmp_path: Path) -> None:
    path = tmp_path / "a.blf"
    with can.BLFWriter(path) as writer:
        for message in plain(50):
            writer.on_message_received(message)
        writer._flush()  # a killed recorder leaves what this put on disk
        writer.file.flush()
        log = read_log(path)
        assert len(concatenate(log)) == 50
        assert log.notice is not None
    log = read_log(path)
    assert len(concatenate(log)) == 50
    assert log.notice is None
