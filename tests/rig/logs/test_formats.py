"""Logs of other formats: read whole, and written and read again."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import concatenate
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log
from tests.rig.logs.messages import from_messages
from tests.rig.logs.samples import START_S, by_python_can, content, kinds, plain, relative_ns


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


@pytest.mark.parametrize("suffix", [".asc", ".trc", ".csv"])
def test_compressed_text(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_log(read_log(by_python_can(tmp_path / "a.log", plain(50))), path)
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


def test_a_peak_log_holds_no_error_frames(tmp_path: Path) -> None:
    by_python_can(tmp_path / "a.blf", kinds())
    with pytest.raises(
        LogError,
        match=r"b.trc: a PEAK trace holds no error frames, and .*a.blf has 1 error frame; ",
    ):
        write_log(read_log(tmp_path / "a.blf"), tmp_path / "b.trc")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.blf"]
