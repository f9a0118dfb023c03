"""Logs cut off, damaged or something else: refused in one line, or their missing end noted."""

from __future__ import annotations

from pathlib import Path

import can
import numpy as np
import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import (
    concatenate,
)
from can_rig.logs.reading import read_log
from tests.rig.logs.samples import by_python_can, content, plain


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
        between_lines |= data[cut:].lstrip(b" ")[:1] in b"\r\n"  # all bytes of a frame are there
        if log.notice is None:
            assert between_lines or not data[cut:].strip()
        else:
            assert "\n" not in log.notice
    assert most >= (0 if suffix == ".blf" else 5)  # the only container of this BLF is cut


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
    ("head", "said"),
    [
        ("MDF     4.10    " + "\0" * 1000, "an MDF 4 file that is cut off or damaged"),
        ("MDF     3.30" + "\0" * 88, "not an MDF 4 file"),
    ],
)
def test_an_mdf_file_without_groups_is_refused(tmp_path: Path, head: str, said: str) -> None:
    path = tmp_path / "a.mf4"
    path.write_text(head, "ascii")
    with pytest.raises(LogError, match=f"^{path}: {said}"):
        concatenate(read_log(path))


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
