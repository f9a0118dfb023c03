"""A recorded drive as a CSV: units, clocks, gaps, the world beside the speed, and refusals."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from can_rig.errors import ScenarioError
from can_rig.plant.disturbances import CALM, Disturbances
from can_rig.scenario import SHIPPED
from can_rig.scenario.driving import (
    WORLD_COLUMNS,
    SpeedProfile,
    follow_rows,
    notes_of_drive,
    speed_profile,
)
from can_rig.scenario.loading import load
from tests.helpers import refuses

WLTC = SHIPPED / "wltc-class-3b.csv"


def recorded(folder: Path, text: str, *settings: str) -> SpeedProfile:
    (folder / "v.csv").write_text(text, encoding="utf-8")
    given = [f"drive.file={folder / 'v.csv'}", "duration_s=10", *settings]
    return speed_profile(load("default", given))


def test_the_wltc_has_the_figures_of_the_regulation():
    """Distance of each phase in m and its highest speed in km/h: UN GTR No. 15, Annex 1."""
    profile = speed_profile(load("default", [f"drive.file={WLTC}", "duration_s=1801"]))
    seconds, kmh = profile.time_s, 3.6 * profile.speed_mps
    assert seconds.tolist() == list(range(1801))
    phases = [(0, 589, 3095, 56.5), (590, 1022, 4756, 76.6), (1023, 1477, 7162, 97.4)]
    for first, last, metres, fastest in (*phases, (1478, 1800, 8254, 131.3)):
        phase = kmh[first : last + 1]
        assert phase.sum() / 3.6 == pytest.approx(metres, abs=0.6)
        assert phase.max() == pytest.approx(fastest)
        assert phase[-1] == 0.0
    assert kmh.sum() / 3600 == pytest.approx(23.27, abs=0.005)
    assert not profile.notes


@pytest.mark.parametrize(
    ("header", "factor"),
    [("time_s,speed_mps", 1.0), ("t,v [m/s]", 1.0), ("Time (s),speed_m_s", 1.0),
     ("time_s,speed_kmh", 1 / 3.6), ("second,km/h", 1 / 3.6), ("t,GPS speed (km/h)", 1 / 3.6),
     ("t,Vehicle_Speed_kph", 1 / 3.6), ("time_s,speed_mph", 1609.344 / 3600)],
)  # fmt: skip
def test_the_header_says_the_unit(header, factor, tmp_path):
    profile = recorded(tmp_path, f"{header}\n0,36\n1,37.5\n")
    assert profile.speed_mps == pytest.approx([36 * factor, 37.5 * factor], rel=1e-15)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("ms", 1e-3), ("msec", 1e-3), ("millis", 1e-3), ("milliseconds", 1e-3), ("µs", 1e-6),
     ("\u03bcs", 1e-6), ("microseconds", 1e-6), ("ns", 1e-9), ("minutes", 60.0), ("hours", 3600.0)],
)  # fmt: skip
def test_the_header_says_the_unit_of_the_times(unit, factor, tmp_path):
    profile = recorded(tmp_path, f"time ({unit}),speed_mps\n0,10\n2,11\n")
    assert profile.time_s == pytest.approx([0.0, 2 * factor], rel=1e-15)


@pytest.mark.parametrize(
    "header", ["acceleration_mps2", "a (m/s²)", "a [m/s^2]", "a_m_s2", "a m/s/s", "a (km/h/s)"]
)
def test_an_acceleration_is_no_speed(header, tmp_path):
    profile = recorded(tmp_path, f"time_s,{header},speed_kmh\n0,1,36\n1,1,37.5\n")
    assert profile.speed_mps == pytest.approx([10.0, 37.5 / 3.6], rel=1e-15)
    with pytest.raises(ScenarioError, match="must have a column speed_mps"):
        recorded(tmp_path, f"time_s,{header}\n0,3\n1,4\n")


@pytest.mark.parametrize(
    "rows",
    [["0,10", "1.5,11", "3,12"], ["1777888800,10", "1777888801.5,11", "1777888803,12"],
     ["23:59:59,10", "00:00:00.5,11", "0:00:02,12"],
     ["2026-05-04T10:00:00Z,10", "2026-05-04T10:00:01.500Z,11", "2026-05-04T12:00:03+02:00,12"],
     ["2026-05-04 10:00:00,10", "2026-05-04 10:00:01.5,11", "2026-05-04 10:00:03,12"]],
)  # fmt: skip
def test_absolute_times_count_from_the_first_row(rows, tmp_path):
    for header in ("time,speed_mps", ""):
        profile = recorded(tmp_path, "\n".join([header, *rows]))
        assert profile.time_s == pytest.approx([0.0, 1.5, 3.0], abs=1e-6)
        assert profile.speed_mps.tolist() == [10.0, 11.0, 12.0]


def test_columns_stand_in_any_order_and_others_are_named(tmp_path):
    text = "lat;speed_kmh;lon;time_ms\n48,1;36,0;11,2;500\n48,1;45,0;11,2;2500\n"
    profile = recorded(tmp_path, text)
    assert profile.time_s.tolist() == [0.5, 2.5] and profile.speed_mps.tolist() == [10.0, 12.5]
    (note,) = profile.notes
    assert note.endswith("columns without effect: lat, lon")


def test_rows_without_a_speed_are_bridged_up_to_the_longest_gap(tmp_path):
    text = "time_s,speed_mps\n0,10\n1,\n2,nan\n4,12\n"
    assert recorded(tmp_path, text)(np.array([2.0])) == [11.0]
    with pytest.raises(ScenarioError, match=r"line 5: 4 s without a speed since line 2: must be"):
        recorded(tmp_path, text, "drive.gap_max_s=3.9")
    steady = "".join(f"{k / 10},10\n" for k in range(20))
    with pytest.raises(ScenarioError, match=r"line 21: 3.1 s without a speed since line 20: "):
        recorded(tmp_path, steady + "5,10\n", "drive.gap_max_s=3")


@given(
    st.lists(st.floats(0.05, 3.0), min_size=2, max_size=30),
    st.lists(st.floats(0.0, 60.0), min_size=30, max_size=30),
    st.floats(0.5, 9.0),
)
def test_no_row_is_further_from_the_one_before_than_the_rate_allows(intervals, speeds, rate):
    times = np.cumsum(intervals)
    asked = np.array(speeds[: len(times)])
    driven = asked.copy()
    follow_rows(times, driven, rate)
    assert driven[0] == asked[0]
    for k, (before, after) in enumerate(pairwise(times), 1):
        reach = rate * (after - before)
        assert abs(driven[k] - driven[k - 1]) <= reach * (1 + 1e-12)
        if abs(asked[k] - driven[k - 1]) <= reach:
            assert driven[k] == asked[k]  # nothing else is changed


def test_what_was_limited_is_said(tmp_path):
    text = "time_s,speed_mps\n0,10\n1,30\n2,20\n3,21\n"
    profile = recorded(tmp_path, text)
    assert profile.speed_mps == pytest.approx([10.0, 18.0, 20.0, 21.0], abs=1e-6)
    (note,) = profile.notes
    assert "1 of 4 rows are limited, by 12 m/s at most, the first in line 3" in note
    assert notes_of_drive(load("default")) == ()


def test_a_drive_brings_its_world(tmp_path):
    """The same straight lines at every tick as the columns say, with a disturbance on top."""
    rows = ["0,20,0,1,100,50,3", "2,22,5,0.4,300,-50,5"]
    header = "time_s,speed_mps,bank_percent,friction,side_force_n,yaw_moment_nm,steering_kick_nm"
    recorded(tmp_path, "\n".join([header, *rows]))
    gust = "disturbance={kind='gust', at_s=0, ramp_s=0, force_n=7, arm_m=0}"
    file = f"drive.file={tmp_path / 'v.csv'}"
    made = Disturbances(load("default", [file, "duration_s=4", gust]))
    found = made.at(range(4000))
    assert found[0].tolist() == CALM.tolist()
    bank = math.atan(0.05)
    expected = {0.5: [157, 25, bank / 4, 3.5, 0.85, 0.85], 3.0: [307, -50, bank, 5, 0.4, 0.4]}
    for time_s, row in expected.items():
        assert found[round(1e3 * time_s)] == pytest.approx(row, rel=1e-12)
    assert len(expected[0.5]) == len(WORLD_COLUMNS)


BAD = {
    "time,speed\n0,10\n": "line 1: 'speed': must say its unit: speed_mps or speed_kmh or",
    "time_s,speed_knots\n0,10\n": "line 1: 'speed_knots': must say its unit",
    "time_s,speed_kmh,speed_mph\n0,1,1\n": "'speed_kmh' and 'speed_mph': must be one column",
    "time_s,utc,speed_kmh,x\n": "has no rows",
    "time,utc,speed_kmh\n0,1,1\n": "line 1: 'time' and 'utc': must be one column, time_s",
    "lat,lon\n48,11\n": "line 1: 'lat,lon': must have a column speed_mps or speed_kmh",
    "speed_kmh\n36\n": "line 1: 'speed_kmh': must have a column time_s",
    "time_s,speed_mps,bank_percnt\n0,1,2\n": "line 1: 'bank_percnt': must be bank_percent",
    "time_s,speed_mps,side_force\n0,1,2\n": "line 1: 'side_force': must be side_force_n",
    "time_s,speed_mps\n0,10,3\n": "line 2: '0,10,3': must be 2 cells",
    "time_s,speed_mps\n0,fast\n": "line 2: '0,fast': must be 2 cells",
    "time_s,speed_mps\n0,inf\n": "line 2: '0,inf': must be",
    "time_s,speed_mps\n0,10\n1,-0.5\n": "line 3: speed_mps = -0.5: must be 0 to 100",
    "time_s,speed_kmh\n0,10\n1,720\n": "line 3: speed_mps = 200: must be 0 to 100",
    "time_s,speed_mps\n0,10\n0,11\n": "line 3: 0 s after 0 s: times must increase",
    "time,speed_mps\n10:00:02,1\n10:00:01,1\n": "line 3: -1 s after 0 s: times must increase",
    "time,speed_mps\n10:00,1\n": "line 2: '10:00': must be a time: seconds, hh:mm:ss, or a date",
    "time,speed_mps\n1:00:00 PM,1\n": "line 2: '1:00:00 PM': must be a time",
    "time,speed_mps\n10:61:00,1\n": "line 2: '10:61:00': must be a time",
    "time,speed_mps\n24/11/2026 10:00:00,1\n": "must be a time",
    "time,speed_mps\n0,1\n10:00:01,1\n": "line 3: '10:00:01': must be seconds like the time",
    "time,speed_mps\n10:00:01,1\n2,1\n": "line 3: '2': must be hh:mm:ss like the time before",
    "time,speed_mps\n2026-05-04T10:00:00,1\n2026-05-04T10:00:01Z,1\n": (
        "line 3: '2026-05-04T10:00:01Z': must be a date and a time without a time zone like"
    ),
    "time,speed_mps\n1777888800000,1\n": "a header time_ms says milliseconds",
    "time_s,speed_mps\n20,1\n21,1\n": "begins at 20 s, and the run ends at 10 s",
    "time_s,speed_mps,friction\n0,10,0\n": "line 2: friction = 0: must be 0.01 to 2",
    "time_s,speed_mps,bank_percent\n0,10,101\n": "line 2: bank_percent = 101: must be -100 to 100",
    "time_s,speed_mps,bank_percent\n0,10,\n": "line 2: '0,10,': must be 3 cells",
    "time_s,speed_mps,bank_percent,bank_rad\n0,1,0,0\n": "must not stand beside bank_rad",
    "time_s,speed_mps,friction,rear_friction\n0,1,1,1\n": "must not stand beside rear_friction",
    "time_s,speed_mps\n0,\n": "has no rows",
    "0,10\x00\n": "line 1: must be text, without NUL",
    '0,10\n1,"11\n2,12\n': "line 2: '1,\"11': must have quotation marks in pairs",
}


@pytest.mark.parametrize(("text", "reason"), BAD.items(), ids=range(len(BAD)))
def test_what_is_wrong_is_one_line_with_file_and_line(text, reason, tmp_path):
    with refuses(reason) as caught:
        recorded(tmp_path, text)
    where = f"scenario default: drive.file = '{tmp_path / 'v.csv'}': "
    assert str(caught.value).startswith(where)
