"""candump logs that are cut off, damaged or not there: what must not be passed over."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from can_rig.errors import LogError
from can_rig.logs.frames import (
    concatenate,
)
from can_rig.logs.reading import read_log
from tests.rig.logs.candump_samples import CANDUMP, DIRECTED, rows, whole, written


@pytest.mark.parametrize(
    "line",
    [
        "hello",
        "(1.0) can0",
        "(1.0) can0 123",
        "(1.0)can0 123#",
        "1.0 can0 123#",
        "(x) can0 123#",
        "(1.0 can0 123#",
        "(12345678901.0) can0 123#",
        "(9999999999.0) can0 123#",
        "(1.0) can0 123#1",
        "(1.0) can0 123#11223344556677889",
        "(1.0) can0 123#112233445566778899",
        "(1.0) can0 123#XY",
        "(1.0) can0 123#11 X",
        "(1.0) can0 123#11 R R",
        "(1.0) can0 FFF#11",
        "(1.0) can0 123456789#11",
        "(1.0) can0 #11",
        "(1.0) can0 123##",
        "(1.0) can0 123##G",
        "(1.0) can0 123##0" + "11" * 65,
        "(1.0) can0 123#R9",
        "(1.0) can0 123#11_9",
        "(1.0) can0 123#1122334455667788_8",
        "(1.0) can0 123#1122334455667788_",
        "\0\0\0\0",
        CANDUMP.splitlines()[-1],  # blanks within the payload
    ],
)
def test_what_is_no_frame_is_named(tmp_path: Path, line: str) -> None:
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
def test_damage_is_refused_or_read_and_never_more(tmp_path_factory, junk, at, cut) -> None:
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


def test_cut_off_at_every_byte(tmp_path: Path) -> None:
    """Every line that has its end is read; of the last one, what cannot go on."""
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


def test_compressed_and_cut_off(tmp_path: Path) -> None:
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
    [
        ("a.txt", "unknown log format; the suffix must be one of .log, .asc"),
        ("a.blf.gz", "unknown log format"),
        ("log", "unknown log format"),
    ],
)
def test_names_that_say_nothing(tmp_path: Path, name: str, reason: str) -> None:
    with pytest.raises(LogError, match="there is no such file"):
        read_log(tmp_path / name)
    (tmp_path / name).write_text("no log\n")
    with pytest.raises(LogError, match=reason):
        read_log(tmp_path / name)


def test_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no.log: there is no such file"):
        list(read_log(tmp_path / "no.log"))
    (tmp_path / "folder.log").mkdir()
    with pytest.raises(LogError, match="is a folder"):
        list(read_log(tmp_path / "folder.log"))
