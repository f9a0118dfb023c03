"""candump logs: what candump writes and what python-can reads, in blocks of any size."""

import gzip
import io
import re

import can
import pytest
from can.io import CanutilsLogReader, CanutilsLogWriter
from hypothesis import example, given, settings, strategies as st

from can_rig.errors import LogError
from can_rig.logs.frames import (
    BITRATE_SWITCH,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    REMOTE,
    SENT,
    concatenate,
)
from can_rig.logs.reading import read_log
from tests.drawn_frames import frames
from tests.rig.logs.candump_samples import CANDUMP, DIRECTED, GOOD, rows, whole, written


def test_what_candump_writes(tmp_path):
    found = rows(whole(written(tmp_path, GOOD)))
    base = 1436509052_000000000
    assert found[0] == (base + 249713000, 0x44, 0, "vcan0", 5, bytes.fromhex("2A366C2BBA"))
    assert [row[1:5] for row in found[2:]] == [
        (0x12345678, EXTENDED | REMOTE, "can1", 0),
        (0x123, REMOTE, "can1", 4),
        (0x555, EXTENDED, "vcan0", 0),
        (0x5A1, FD, "vcan0", 0),
        (0x5A1, FD | BITRATE_SWITCH | ERROR_STATE, "vcan0", 15),
        (0x1F334455, EXTENDED | FD | BITRATE_SWITCH, "vcan0", 8),
        (0x88, ERROR, "can1", 8),
        (4, ERROR, "can1", 8),
        (0x4F8, 0, "vcan0", 2),
    ]
    assert found[9][5] == bytes.fromhex("000C0000000060")
    directed = rows(whole(written(tmp_path, DIRECTED)))
    assert [row[2] & SENT for row in directed] == [SENT * (at % 2) for at in range(11)] + [0]
    assert [(*r[:2], r[2] & ~SENT, *r[3:]) for r in directed[:-1]] == found
    assert directed[-1][4:] == (8, bytes.fromhex("1122334455667788"))


@pytest.mark.parametrize("chunk_frames", [1, 1 << 18])
def test_a_comment_is_passed_over(tmp_path, chunk_frames):
    """At the beginning, between frames, and at an end without a newline."""
    first, others = GOOD.split("\n", 1)
    text = f"# (1.0) vcan0 1#00\n\n  # a drive\n{first}\n#{first}\n{others}# no more"
    log = read_log(written(tmp_path, text), chunk_frames)
    assert rows(concatenate(log)) == rows(whole(written(tmp_path, GOOD, "b.log")))
    assert log.notice is None


def recorded(message: can.Message, channel: str, time_us: int, sent: bool) -> can.Message:
    message.channel, message.timestamp, message.is_rx = channel, time_us / 1e6, not sent
    return message


frames_drawn = st.builds(
    recorded,
    frames(["data", "data", "fd", "remote"]),
    st.sampled_from(["can0", "van0", "vcan17", "a"]),
    st.integers(0, 2_000_000_000_000_000),
    st.booleans(),
)


@settings(max_examples=60)
@given(st.lists(frames_drawn, max_size=20), st.integers(1, 7))
def test_the_same_frames_as_python_can(tmp_path_factory, messages, chunk_frames):
    """Of a log that python-can wrote, read by python-can."""
    folder = tmp_path_factory.mktemp("log")
    messages.sort(key=lambda m: m.timestamp)  # its writer does not go back in time
    text = io.StringIO()
    writer = CanutilsLogWriter(text)
    for message in messages:
        writer.on_message_received(message)
    path = written(folder, text.getvalue())
    theirs = list(CanutilsLogReader(path))
    ours = list(whole(path, chunk_frames).messages())
    assert len(ours) == len(theirs)
    for mine, other in zip(ours, theirs, strict=True):
        assert mine.equals(other, timestamp_delta=1e-6)
        assert mine.channel == other.channel


def test_time_stamps_are_exact(tmp_path):
    stamps = ["0", "0.1", "1.000000001", "1699999999.123456789", "9223372035.9", "3.1234567894"]
    text = "".join(f"({stamp}) can0 1#\n" for stamp in stamps)
    assert whole(written(tmp_path, text)).time_ns.tolist() == [
        0,
        100_000_000,
        1_000_000_001,
        1_699_999_999_123_456_789,
        9_223_372_035_900_000_000,
        3_123_456_789,  # what is finer than a nanosecond is cut off
    ]


@pytest.mark.parametrize("block", [1, 7, 100])
def test_blocks_of_any_size(tmp_path, monkeypatch, block):
    plain, packed = (written(tmp_path, DIRECTED * 2), gzip.compress((DIRECTED * 2).encode()))
    every = rows(whole(plain))
    monkeypatch.setattr("can_rig.logs.text.BLOCK_BYTES", block)
    assert rows(whole(plain)) == every
    assert rows(whole(written(tmp_path, packed, "a.log.gz"))) == every


def test_chunks_are_bounded_and_the_same(tmp_path):
    path = written(tmp_path, DIRECTED * 40)
    chunks = list(read_log(path, chunk_frames=7))
    assert max(map(len, chunks)) <= 7
    assert rows(concatenate(chunks)) == rows(whole(path))


def test_a_log_may_be_read_again(tmp_path):
    log = read_log(written(tmp_path, GOOD))
    assert len(concatenate(log)) == len(concatenate(log)) == 11
    assert log.start_ns == 1436509052_249713000
    assert log.fraction == 1.0


@pytest.mark.parametrize(
    "line",
    # the last has blanks within the payload
    ["hello", "(1.0) can0", "(1.0) can0 123", "(1.0)can0 123#", "1.0 can0 123#", "(x) can0 123#",
     "(1.0 can0 123#", "(12345678901.0) can0 123#", "(9999999999.0) can0 123#", "(1.0) can0 123#1",
     "(1.0) can0 123#11223344556677889", "(1.0) can0 123#112233445566778899", "(1.0) can0 123#XY",
     "(1.0) can0 123#11 X", "(1.0) can0 123#11 R R", "(1.0) can0 FFF#11", "(1.0) can0 123456789#11",
     "(1.0) can0 #11", "(1.0) can0 123##", "(1.0) can0 123##G", "(1.0) can0 123##0" + "11" * 65,
     "(1.0) can0 123#R9", "(1.0) can0 123#11_9", "(1.0) can0 123#1122334455667788_8",
     "(1.0) can0 123#1122334455667788_", "\0\0\0\0", CANDUMP.splitlines()[-1]],
)  # fmt: skip
def test_what_is_no_frame_is_named(tmp_path, line):
    log = read_log(written(tmp_path, f"(0.5) can0 1#\n\n{line}\n(2.0) can0 1#\n"))
    found = []
    with pytest.raises(
        LogError, match=r"a.log: line 3: not a frame as candump -L writes it"
    ) as error:
        found.extend(log)
    assert "\n" not in str(error.value)
    assert len(concatenate(found)) == 1  # what was before it came


@settings(max_examples=300)
@given(st.binary(max_size=60), st.integers(0, 70), st.integers(0, 10))
@example(b"\n", 10, 0)
@example(b"_", 40, 0)
def test_damage_is_refused_or_read_and_never_more(tmp_path_factory, junk, at, cut):
    """Bytes put into a line, or in place of some: an error with its line, or frames."""
    line = b"(1436509053.451125) vcan0 5A1##3112233445566778899AABBCCDDEEFF R\n"
    text = line + line[:at] + junk + line[at + cut :] + line
    path = written(tmp_path_factory.mktemp("log"), text)
    try:
        frames = whole(path)
    except LogError as error:
        assert re.search(r"line \d+: ", str(error))
    else:
        assert 1 <= len(frames) <= 3 + junk.count(b"\n") + junk.count(b"#")


def test_cut_off_at_every_byte(tmp_path):
    """Each whole line is read, and of a cut last line each field with an end."""
    every = rows(whole(written(tmp_path, DIRECTED)))
    text = DIRECTED.encode()
    for cut in range(len(text) + 1):
        path = written(tmp_path, text[:cut])
        log = read_log(path)
        frames = concatenate(log)
        ended = text[:cut].count(b"\n")
        unfinished = text[:cut].rpartition(b"\n")[2]
        is_whole = re.search(rb" [RT]$", unfinished) is not None
        assert rows(frames) == every[: ended + is_whole]
        if unfinished and not is_whole:
            assert log.notice is not None
            assert f"line {ended + 1}: the file ends within this line" in log.notice
            assert "\n" not in log.notice
        else:
            assert log.notice is None


def test_compressed_and_cut_off(tmp_path):
    text = DIRECTED * 50
    packed = gzip.compress(text.encode())
    every = rows(whole(written(tmp_path, packed, "a.log.gz")))
    assert every == rows(whole(written(tmp_path, text)))
    two = gzip.compress(DIRECTED.encode()) * 50
    assert rows(whole(written(tmp_path, two, "a.log.gz"))) == every
    for cut in range(0, len(packed), 7):
        log = read_log(written(tmp_path, packed[:cut], "a.log.gz"))
        found = rows(concatenate(log))
        assert found == every[: len(found)]
        assert (log.notice is None) == (cut == 0)
    with pytest.raises(LogError, match=r"a.log.gz: not a gzip file, or damaged"):
        whole(written(tmp_path, text, "a.log.gz"))


@pytest.mark.parametrize(
    ("name", "reason"),
    [("a.txt", "unknown log format; the suffix must be one of .log, .asc"),
     ("a.blf.gz", "unknown log format"), ("log", "unknown log format")],
)  # fmt: skip
def test_names_that_say_nothing(tmp_path, name, reason):
    with pytest.raises(LogError, match="there is no such file"):
        read_log(tmp_path / name)
    (tmp_path / name).write_text("no log\n")
    with pytest.raises(LogError, match=reason):
        read_log(tmp_path / name)


def test_a_folder_is_no_log(tmp_path):
    (tmp_path / "folder.log").mkdir()
    with pytest.raises(LogError, match="is a folder"):
        list(read_log(tmp_path / "folder.log"))
