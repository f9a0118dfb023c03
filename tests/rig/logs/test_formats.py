"""Logs of other formats, read whole; ``test_changes`` has logs written and read again."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from can_rig.logs.frames import concatenate
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log
from tests.rig.logs.messages import from_messages
from tests.rig.logs.samples import by_python_can, content, kinds, plain, relative_ns


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


def test_a_peak_log_tells_its_own_name(tmp_path: Path) -> None:
    by_python_can(tmp_path / "a.log", plain(2))
    write_log(read_log(tmp_path / "a.log"), tmp_path / "b.trc")
    assert f";   {tmp_path / 'b.trc'}" in (tmp_path / "b.trc").read_text("ascii").splitlines()
