"""Logs that other programs wrote: log2asc, CANoe, PCAN-View, asammdf."""

import time
from pathlib import Path

import asammdf
import numpy as np
import pytest
from asammdf import Signal, Source

from can_rig.errors import LogError
from can_rig.logs.frames import ERROR, EXTENDED, FD, REMOTE, SENT, concatenate
from can_rig.logs.reading import read_log
from tests.rig.logs.candump_samples import whole, written
from tests.rig.logs.samples import CANOE, LOG2ASC, PEAK, content, relative_ns


def test_a_log_of_log2asc(tmp_path):
    log = read_log(written(tmp_path, LOG2ASC, "a.asc"))
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


def test_a_log_of_canoe(tmp_path):
    log = read_log(written(tmp_path, CANOE, "a.asc"))
    assert content(concatenate(log)) == [
        (0x123, 0, 2, b"\x0a\x0b"),
        (0x1F334455, EXTENDED | SENT, 1, b"\xff"),
    ]
    begun_s = time.mktime((2017, 9, 30, 15, 6, 13, 0, 0, -1)) + 0.191
    assert log.start_ns == round(begun_s * 1000) * 1_000_000
    assert log.notice is None


def test_time_stamps_from_line_to_line_are_refused(tmp_path):
    path = written(tmp_path, LOG2ASC.replace("absolute", "relative"), "a.asc")
    with pytest.raises(LogError, match=r"a.asc: .*'timestamps relative'.*absolute"):
        whole(path)


def test_a_log_of_pcan_view(tmp_path):
    log = read_log(written(tmp_path, PEAK, "a.trc"))
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
            members: dict[str, np.ndarray] = {
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
def test_groups_are_merged_by_time(tmp_path, groups, chunk_frames):
    log = read_log(bus_logging(tmp_path / "a.mf4", groups), chunk_frames)
    frames = concatenate(log)
    assert relative_ns(frames).tolist() == [at * 10_000_000 for at in range(30)]
    for group in range(groups):
        of_group = frames[group::groups]
        expected = [0x100 * group + at for at in range(len(of_group))]
        assert of_group.arbitration_id.tolist() == expected
        assert (of_group.has(EXTENDED) == (group == 1)).all()
    assert frames.has(SENT).all()
    assert (frames.data == [0, 1, 2, 3, 0, 0, 0, 0]).all()  # bytes behind the length are not data
