"""``bus.log``: candump lines in virtual time, for every kind of frame."""

import itertools
import re
from pathlib import Path
from tempfile import TemporaryDirectory

import can
import numpy as np
import pytest
from hypothesis import given, strategies as st

from can_rig.errors import RunFolderError
from can_rig.nodes.bus_access import Pace
from can_rig.nodes.realtime.timing import Histogram, Timing
from can_rig.nodes.recording import LaterFile, Recorder
from tests.clock import TurnedClock
from tests.drawn_frames import frames
from tests.rig.nodes.world import TICK_NS


def frame(number, **kwargs):
    options = {"arbitration_id": 0x101, "is_extended_id": False, "data": [number] * 8} | kwargs
    return can.Message(**options)


def write(path, tick_ns, ticks):
    """A log of ``ticks``, each a list of (frame, sent)."""
    with Recorder(path) as recorder:
        for tick, frames in enumerate(ticks):
            recorder.at(tick * tick_ns)
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
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bus.log"
        with Recorder(path) as recorder:
            recorder.at(tick * tick_us * 1000)
            recorder.record(frame(0), sent=True)
            recorder.record(frame(1), sent=True)
        times = re.findall(r"^\((\d+)\.(\d{6})\)", path.read_text(), re.MULTILINE)
    assert [int(s) * 10**6 + int(us) for s, us in times] == [tick * tick_us, tick * tick_us + 1]


@given(frames(), st.booleans())
def test_python_can_reads_back_every_kind_of_frame(message, sent):
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bus.log"
        write(path, 1_000_000, [[], [(message, sent)]])
        (back,) = can.LogReader(path)
    assert back.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert back.timestamp == pytest.approx(0.001)
    assert (back.channel, back.is_rx) == ("vcan0", not sent)


@given(
    st.lists(st.integers(0, 300_000_000), min_size=1, max_size=300),
    st.sampled_from([50.0, 99.0, 99.9]),
)
def test_percentiles_are_numpy_s_to_a_microsecond(durations_ns, percent):
    histogram = Histogram()
    for duration_ns in durations_ns:
        histogram.add(duration_ns)
    exact_us = np.percentile(durations_ns, percent, method="inverted_cdf") / 1000
    found = histogram.percentile_us(percent)
    assert histogram.max_us == max(durations_ns) / 1000
    if exact_us < 100_000:
        assert exact_us <= found <= exact_us + 1.0
    else:
        assert found == histogram.max_us
    assert sum(histogram.as_dict()["counts"]) == len(durations_ns)


@given(st.lists(st.integers(0, 5_000_000), min_size=3, max_size=200))
def test_drift_is_the_slope_of_numpy_s_line(lateness_ns):
    timing = Timing(TICK_NS)
    for tick, late_ns in enumerate(lateness_ns, start=7):
        timing.woke(tick, late_ns)
    ticks = np.arange(7, 7 + len(lateness_ns))
    slope = np.polyfit(ticks, np.array(lateness_ns, dtype=float), 1)[0]
    assert timing.drift_ppm == pytest.approx(slope / TICK_NS * 1e6, abs=1e-3)
    wakes = ticks * TICK_NS + np.array(lateness_ns)
    mean_ns = (wakes[-1] - wakes[0]) / (len(wakes) - 1)
    assert timing.period_error_ppm == pytest.approx((mean_ns / TICK_NS - 1) * 1e6, abs=1e-3)
    assert timing.missed_deadlines == sum(late >= TICK_NS for late in lateness_ns)


def test_no_wake_up_has_no_period():
    timing = Timing(TICK_NS)
    assert timing.period_error_ppm is timing.drift_ppm is None
    timing.woke(1, 0)
    assert timing.period_error_ppm is timing.drift_ppm is None


def test_the_thread_writes_every_line_in_order_with_time_that_never_goes_back(tmp_path):
    log = tmp_path / "bus.log"
    with Recorder(log, LaterFile) as recorder:
        for tick in range(2000):
            recorder.at(tick * 900 - 5000 * (tick % 2))
            recorder.record(can.Message(arbitration_id=tick, is_extended_id=False), sent=True)
            if tick % 7 == 0:
                recorder.flush()
    frames = list(can.LogReader(log))
    assert [frame.arbitration_id for frame in frames] == list(range(2000))
    assert all(b.timestamp > a.timestamp for a, b in itertools.pairwise(frames))


def test_a_disk_that_is_full_is_one_line(tmp_path):
    failure = pytest.raises(RunFolderError, match="cannot be written")
    with failure, Recorder(Path("/dev/full"), LaterFile) as full:
        full.record(can.Message(arbitration_id=1, is_extended_id=False), sent=True)
        full.flush()


def test_a_node_that_joins_late_counts_its_own_ticks_only():
    """And not the wait for the first tick."""
    clock, reached = TurnedClock(), []
    pace = Pace(clock, reached.append)
    assert pace.ticks_per_s == 0.0
    clock.pass_s(30.0)
    for tick in range(5000, 7001):
        pace(tick)
        clock.pass_s(0.001)
    assert pace.ticks_per_s == pytest.approx(1000.0, rel=1e-3)
    assert reached == list(range(5000, 7001))
