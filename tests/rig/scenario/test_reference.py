"""References against their formulas, and CSV files as people write them."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from can_rig.errors import ScenarioError
from can_rig.scenario.loading import load
from can_rig.scenario.reference import LANE_CHANGE_S, lane_change, reference
from tests.helpers import refuses


@given(st.floats(-20, 20), st.floats(0.1, 50.0), st.integers(1, 300))
def test_step_and_sine(amplitude, frequency, ticks):
    settings = [f"duration_s={ticks / 500}", "tick_s=0.002"]
    settings += [f"reference.amplitude_mps2={amplitude!r}"]
    settings += [f"reference.frequency_rad_per_s={frequency!r}"]
    step = reference(load("thesis-step", [*settings, "reference.kind=step"]))
    assert step.tolist() == [amplitude] * ticks
    sine = reference(load("thesis-step", [*settings, "reference.kind=sine"]))
    expected = [amplitude * math.sin(frequency * k / 500) for k in range(ticks)]
    assert sine.tolist() == pytest.approx(
        expected, abs=1e-12 * max(1.0, abs(amplitude) * frequency)
    )


@given(st.floats(-5, 5, allow_subnormal=False), st.floats(0.5, 20.0))
def test_a_double_lane_change_ends_on_its_lane(amplitude, omega):
    period = 2.0 * math.pi / omega
    time_s = np.linspace(0.0, LANE_CHANGE_S + 3.0 * period, 30_001)
    r = lane_change(amplitude, omega, time_s)
    step = time_s[1] - time_s[0]
    speed = np.cumsum(r) * step
    offset = np.cumsum(speed) * step
    rounding = 1e-2 * abs(amplitude) / omega

    def at(periods):
        return int(np.searchsorted(time_s, LANE_CHANGE_S + periods * period))

    assert (r[time_s < LANE_CHANGE_S] == 0.0).all()
    assert (r[at(1.0) + 1 : at(1.5) - 1] == 0.0).all()
    assert (r[at(2.5) + 1 :] == 0.0).all()
    assert np.abs(np.diff(r)).max() <= 1.01 * abs(amplitude) * omega * step + 1e-300
    assert abs(r[at(0.25)]) == pytest.approx(abs(amplitude), rel=1e-3)
    for periods in (0.0, 1.2, 2.8):  # there is no lateral speed on a lane
        assert speed[at(periods)] == pytest.approx(0.0, abs=rounding)
    aside = 2.0 * math.pi * amplitude / omega**2
    assert offset[at(1.2)] == pytest.approx(aside, abs=rounding * period)
    assert offset[-1] == pytest.approx(0.0, abs=rounding * period)


def test_a_lane_change_is_a_reference_and_happens_once():
    scenario = load("lane-change")
    settings, values = scenario.reference, reference(scenario)
    assert len(values) == scenario.ticks
    time_s = np.arange(scenario.ticks) * scenario.tick_s
    assert np.abs(values).max() == pytest.approx(settings.amplitude_mps2, rel=1e-5)
    expected = lane_change(settings.amplitude_mps2, settings.frequency_rad_per_s, time_s)
    np.testing.assert_allclose(values, expected, atol=1e-12)
    assert (values[time_s > 1.0 + 5.0 * math.pi / settings.frequency_rad_per_s] == 0.0).all()


def from_csv(tmp_path, data, *settings):
    (tmp_path / "r.csv").write_bytes(data if isinstance(data, bytes) else data.encode())
    file = f"reference.file={tmp_path / 'r.csv'}"
    return reference(load("thesis-step", ["reference.kind=csv", file, *settings]))


GOOD = {
    "plain": b"1,10\n2,30\n",
    "header": b"time_s,reference_mps2\n1,10\n2,30\n",
    "header with spaces, Windows line ends": b"time s, r in m/s^2\r\n1, 10\r\n 2 ,30\r\n",
    "byte order mark": b"\xef\xbb\xbf1,10\n2,30\n",
    "byte order mark and header": b"\xef\xbb\xbftime,r\n1,10\n2,30\n",
    "comments and empty lines": b"# a ramp\n\n1,10\n\n2,3e1\n",
    "no last line end": b"1,10\n2,30",
    "another quantity by the minute": b"time,flow in l/min\n1,10\n2,30\n",
    "decimal commas": b"time;r\n1,0;10,0\n2,0;30,0\n",
}


@pytest.mark.parametrize("data", GOOD.values(), ids=GOOD.keys())
def test_a_csv_is_linear_between_its_rows_and_held_beyond_them(data, tmp_path):
    values = from_csv(tmp_path, data, "tick_s=0.25", "duration_s=3")
    assert values.tolist() == [10, 10, 10, 10, 10, 15, 20, 25, 30, 30, 30, 30]


def test_one_row_is_a_constant(tmp_path):
    assert (from_csv(tmp_path, "0,2.5\n") == 2.5).all()


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=20))
def test_rows_on_the_ticks_are_the_values(values):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        rows = "".join(f"{k / 1000!r},{value!r}\n" for k, value in enumerate(values))
        found = from_csv(Path(folder), rows, f"duration_s={len(values) / 1000}")
    assert np.abs(found - values).max() < 1e-10


BAD = {
    "empty": (b"", "has no rows; must have some of time_s,reference_mps2"),
    "header alone": (b"time_s,reference_mps2\n", "has no rows"),
    "one column": (b"1\n2\n", "line 1: '1': must be two finite numbers, time_s,reference_mps2"),
    "three columns": (b"1,2,3\n2,3,4\n", "line 1: '1,2,3': must be two finite numbers"),
    "ragged": (b"1,2\n2,3,4\n", "line 2: '2,3,4': must be two finite numbers"),
    "a word": (b"1,2\n2,fast\n", "line 2: '2,fast': must be two finite numbers"),
    "two headers": (b"a,b\nc,d\n1,2\n", "line 2: 'c,d': must be two finite numbers"),
    "nan": (b"1,2\n2,nan\n", "line 2: '2,nan': must be two finite numbers"),
    "infinite": (b"1,2\n2,inf\n", "line 2: '2,inf': must be two finite numbers"),
    "a gap": (b"t,r\n\n1,2\n2,\n", "line 4: '2,': must be two finite numbers"),
    "points": (b"1.2\n2.3\n", "line 1: '1.2': must be two finite numbers"),
    "milliseconds": (b"time_ms,r\n0,2\n", "line 1: 'time_ms,r': must be time_s,reference_mps2"),
    "microseconds": ("Time [µs],r\n0,2\n".encode(), "must be time_s,reference_mps2"),
    "minutes": (b"time (min),r\n0,2\n", "must be time_s,reference_mps2"),
    "another signal": (b"time_s,speed_mps\n0,2\n", "must be time_s,reference_mps2"),
    "kilometres an hour": (b"t,v [km/h]\n0,2\n", "must be time_s,reference_mps2"),
    "the other way round": (b"reference_mps2,time_s\n1,0\n", "must be time_s,reference_mps2"),
    "milliseconds since 1970": (b"1763880000000,1\n", "line 1: 1763880000000 s: must be seconds"),
    "begins after the run": (b"20,1\n21,2\n", "begins at 20 s, and the run ends at 20 s"),
    "time stands still": (b"1,2\n1,3\n", "line 2: 1 s after 1 s: times must increase"),
    "beyond any frame": (b"1,2\n2,-1e300\n", "|reference_mps2| = 1e+300: must be at most 1e+06"),
    "time runs back": (b"2,2\n1,3\n", "times must increase"),
    "not text": (b"\xff\xfe1,2", "must be text in UTF-8"),
}


@pytest.mark.parametrize(("data", "reason"), BAD.values(), ids=BAD.keys())
def test_a_bad_csv_is_one_line_that_names_the_file(data, reason, tmp_path, recwarn):
    with refuses(reason) as caught:
        from_csv(tmp_path, data)
    message = str(caught.value)
    assert message.startswith("scenario thesis-step: reference.file = ")
    assert str(tmp_path / "r.csv") in message
    # the collector may find what an earlier test has left open
    assert not [each for each in recwarn if each.category is not ResourceWarning]


def test_a_csv_that_is_not_there_or_a_folder(tmp_path):
    for path, reason in ((tmp_path / "none.csv", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(ScenarioError, match=reason):
            reference(load("thesis-step", ["reference.kind=csv", f"reference.file={path}"]))
