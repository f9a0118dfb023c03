"""``bus.log``: candump lines in virtual time, on disk tick by tick, for every kind of frame."""

import re

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_rig.nodes.recording import Recorder


def frame(number, **kwargs):
    options = {"arbitration_id": 0x101, "is_extended_id": False, "data": [number] * 8} | kwargs
    return can.Message(**options)


def write(path, tick_ns, ticks):
    """A log of ``ticks``, each a list of (frame, sent)."""
    with Recorder(path, tick_ns) as recorder:
        for tick, frames in enumerate(ticks):
            recorder.begin_tick(tick)
            for message, sent in frames:
                recorder.record(message, sent)
    return path.read_text()


def test_the_nth_frame_of_tick_k_is_at_k_ticks_and_n_microseconds(tmp_path):
    ticks = [[(frame(n), n < 2) for n in range(5)] for _ in range(3)]
    lines = write(tmp_path / "bus.log", 2_000_000, ticks).splitlines()
    expected = [
        f"(0.{tick * 2000 + n:06d}) vcan0 101#{f'{n:02X}' * 8} {'T' if n < 2 else 'R'}"
        for tick in range(3)
        for n in range(5)
    ]
    assert lines == expected


@given(st.integers(0, 10**10), st.integers(10, 10**6))
def test_times_are_exact_decimals_however_long_the_run(tick, tick_us):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bus.log"
        with Recorder(path, tick_us * 1000) as recorder:
            recorder.begin_tick(tick)
            recorder.record(frame(0), sent=True)
            recorder.record(frame(1), sent=True)
        times = re.findall(r"^\((\d+)\.(\d{6})\)", path.read_text(), re.MULTILINE)
    assert [int(s) * 10**6 + int(us) for s, us in times] == [tick * tick_us, tick * tick_us + 1]


OTHER = [
    {"is_extended_id": True, "arbitration_id": 0x1ABCDEF0},
    {"is_extended_id": True, "arbitration_id": 0x101},
    {"data": []},
    {"data": [1, 2, 3]},
    {"is_remote_frame": True, "data": None, "dlc": 0},
    {"arbitration_id": 0x7FF},
    {"arbitration_id": 0},
]


@pytest.mark.parametrize("kwargs", OTHER, ids=str)
@pytest.mark.parametrize("sent", [True, False])
def test_python_can_reads_back_every_kind_of_frame(kwargs, sent, tmp_path):
    path = tmp_path / "bus.log"
    message = frame(7, **kwargs)
    write(path, 1_000_000, [[], [(message, sent)]])
    (back,) = can.LogReader(path)
    assert back.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert back.timestamp == pytest.approx(0.001)
    assert (back.channel, back.is_rx) == ("vcan0", not sent)


def test_a_tick_is_on_disk_when_the_next_begins_and_all_of_it_at_the_end(tmp_path):
    path = tmp_path / "bus.log"
    with Recorder(path, 1_000_000) as recorder:
        for tick in range(50):
            recorder.begin_tick(tick)
            assert len(path.read_text().splitlines()) == 5 * tick
            for n in range(5):
                recorder.record(frame(n), sent=True)
    assert len(path.read_text().splitlines()) == 250
