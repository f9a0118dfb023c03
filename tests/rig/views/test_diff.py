"""Two runs beside each other; a log under a different scenario."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from can_rig.drawing.names import unit_of
from can_rig.errors import LogError
from can_rig.scenario.loading import load
from can_rig.views.diff import compare, tolerances_of
from can_rig.views.pictures import difference_page
from can_rig.views.signal_table import SignalTable, read_table
from tests.helpers import asked, refused, succeeded

SHORT = ("--set", "duration_s=0.3", "--set", "fault.at_s=0.2", "--in-process")


def table(label: str = "a", start: int = 0, **columns: list[float]) -> SignalTable:
    values = {name: np.array(column, dtype=np.float64) for name, column in columns.items()}
    rows = len(next(iter(values.values())))
    return SignalTable(label, (start + np.arange(rows)) * 1_000_000, values)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for name, change in (("a", ()), ("again", ()), ("later", ("--set", "fault.at_s=0.25"))):
        succeeded("run", "thesis-sine", *SHORT, *change, "--out", folder / name)
    return folder


def test_the_same_run_twice_is_the_same(runs):
    done = asked("diff", runs / "a", runs / "again")
    assert (done.returncode, done.stderr) == (0, "")
    assert "the same in all 300 rows" in done.stdout
    log = succeeded(
        "diff", runs / "a", runs / "a" / "bus.log", "--scenario", "thesis-sine", "--json"
    )
    assert json.loads(log.stdout)["rows"] == 300
    assert asked("convert", runs / "a" / "bus.log", "bus.csv").returncode == 0
    log = asked("diff", runs / "a", "bus.csv", "--scenario", "thesis-sine", "--json")
    assert json.loads(log.stdout)["rows"] == 300  # a log, though signals.csv is another .csv


def test_what_diff_leaves_out_of_a_log_is_said(runs):
    """A log of two runs: the first run, or the run after ``--from``; a log that is cut off."""
    both = (runs / "a" / "bus.log").read_text() + (
        (runs / "later" / "bus.log").read_text().replace("(0.", "(10.")
    )
    Path("both.log").write_text(both)
    done = asked("diff", "both.log", "both.log")
    assert "the same in all 300 rows" in done.stdout
    note = "note: both.log: 299 ticks are left out; they do not go on"  # the last is a repetition
    assert done.stderr.count(note) == 2
    Path("later.log").write_text((runs / "later" / "bus.log").read_text())
    done = asked("diff", "both.log", "later.log", "--json", "--from", "0.1")
    assert done.returncode == 1 and json.loads(done.stdout)["rows"] == 200
    Path("cut.log").write_text(both[:-9])
    done = asked("diff", "both.log", "cut.log", "--from", "5")
    assert done.returncode == 1 and "in 300 common rows" in done.stdout
    assert "the file ends within this line" in done.stderr and "left out" not in done.stderr


def test_a_later_fault_parts_them_at_the_fault(runs):
    done = asked("diff", runs / "a", runs / "later", "--out", "apart.png", "--json")
    assert done.returncode == 1
    result = json.loads(done.stdout)
    assert 0.2 <= result["first_at_s"] <= 0.202
    assert Path("apart.png").read_bytes().startswith(b"\x89PNG")
    by_name = {signal["signal"]: signal for signal in result["signals"]}
    assert by_name["reference_mps2"]["beyond"] == 0
    allowed = [f"{name}={1.01 * s['largest'] + 1e-12}" for name, s in by_name.items()]
    within = asked(
        "diff", runs / "a", runs / "later", *(a for t in allowed for a in ("--tolerance", t))
    )
    assert within.returncode == 0, within.stdout


def test_the_name_of_a_signal_stands_in_one_line(runs):
    done = asked("diff", runs / "a", runs / "later")
    assert "\napplied_force_difference_n " in done.stdout


@given(
    arrays(np.float64, 40, elements=st.sampled_from([0.0, 1.0, 1.5, -2.0, math.nan])),
    arrays(np.float64, 40, elements=st.sampled_from([0.0, 1.0, 1.5, -2.0, math.nan])),
    st.sampled_from([0.0, 0.5, 1.0, 3.0]),
)
def test_differences_are_those_of_a_plain_loop(a, b, tolerance):
    (found,) = compare(table(x=list(a)), table(x=list(b)), {"x": tolerance}).signals
    beyond, largest = [], 0.0
    for row, (one, other) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        if math.isnan(one) != math.isnan(other):
            beyond.append(row)
        elif not math.isnan(one):
            largest = max(largest, abs(one - other))
            if abs(one - other) > tolerance:
                beyond.append(row)
    assert (found.beyond, found.largest) == (len(beyond), largest)
    if beyond:
        assert found.first_at_s == pytest.approx(beyond[0] * 1e-3)
        for value, column in ((found.first_a, a), (found.first_b, b)):
            there = column[beyond[0]]
            assert value is None if math.isnan(there) else value == there
    else:
        assert found.first_at_s is None


def test_rows_and_columns_of_one_run_alone_are_a_difference():
    longer = compare(table(x=[1, 2, 3]), table("b", x=[1, 2]), {})
    assert (longer.rows, longer.only_a, longer.only_b, longer.same) == (2, 1, 0, False)
    shifted = compare(table(x=[1, 2, 3]), table("b", start=1, x=[2, 3, 4]), {})
    assert (shifted.rows, shifted.only_a, shifted.only_b) == (2, 1, 1)
    assert shifted.signals[0].beyond == 0
    wider = compare(table(x=[1]), table("b", x=[1], y=[1]), {})
    assert (wider.columns_b, wider.same) == (["y"], False)
    assert compare(table(x=[1]), table("b", x=[1]), {}).same
    with pytest.raises(LogError, match="no row of the same time"):
        compare(table(x=[1]), table("b", start=5, x=[1]), {})


def test_bad_words_are_one_line(runs):
    Path("bad.csv").write_text("time_s,x\n0,1\n1,two\n")
    Path("ragged.csv").write_text("time_s,x\n0,1\n1\n")
    Path("back.csv").write_text("time_s,x\n1,1\n0,1\n")
    Path("no-time.csv").write_text("x\n1\n")
    Path("empty.csv").write_text("")
    a = runs / "a"
    for arguments, words in (
        ((a, a, "--tolerance", "torqe_nm=1"), "did you mean torque_nm?"),
        ((a, a, "--tolerance", "torque_nm=-1"), "0 or above"),
        ((a, a, "--tolerance", "torque_nm"), "SIGNAL=VALUE"),
        ((a, a, "--out", "x.gif"), "FILE.png, FILE.svg or FILE.pdf"),
        ((a, runs), "has no signals.csv"), ((a, "gone.log"), "there is no such file"),
        ((a, "bad.csv"), "not a table of numbers"), ((a, "ragged.csv"), "not a table of numbers"),
        ((a, "back.csv"), "does not increase"), ((a, "no-time.csv"), "has no column time_s"),
        ((a, "empty.csv"), "not a table of numbers"),
    ):  # fmt: skip
        if arguments[-1].__class__ is str and arguments[-1].endswith(".csv"):
            with pytest.raises(LogError, match=words):
                read_table(Path(arguments[-1]), load("default"))
            continue
        assert words in refused("diff", *arguments)


def test_tolerances_and_units():
    assert tolerances_of(["a=0.5", "b=1e-3"]) == {"a": 0.5, "b": 1e-3}
    expected = {
        "torque_nm": "N m", "force_difference_n": "N", "dstar_mps2": "m/s²",
        "yaw_rate_rad_per_s": "rad/s", "limits.force_difference_rate_n_per_s": "N/s",
        "plant.steering_damping_nms_per_rad": "N m s/rad", "sensor.drift_per_s": "", "per_s": "",
        "mode": "",
    }  # fmt: skip
    assert {name: unit_of(name) for name in expected} == expected


@pytest.mark.filterwarnings("error")
def test_the_picture_shows_the_place(runs):
    a, b = (read_table(runs / name, load("default")) for name in ("a", "later"))
    difference = compare(a, b, {})
    page = difference_page(a, b, difference)
    whole, near = page.axes[0], page.axes[1]
    low, high = near.get_xlim()
    assert low < difference.first_at_s < high
    assert high - low < 0.1 < whole.get_xlim()[1] - whole.get_xlim()[0]
    assert "m/s²" in whole.get_ylabel()
    same = difference_page(a, a, compare(a, a, {}))
    assert len(same.axes) == 2 * len(a.recorded)


def test_what_if_the_fault_comes_later_is_that_run(runs):
    """The logged sine through the other scenario is the run that was made with it."""
    done = succeeded("replay", runs / "a", "--what-if", "--set", "fault.at_s=0.25", "--out", "if")
    assert Path("if/bus.log").read_bytes() == (runs / "later" / "bus.log").read_bytes()
    assert {"signals.csv", "run.json", "report.png", "what-if.png"} <= {
        path.name for path in Path("if").iterdir()
    }
    succeeded("replay", "if")  # an ordinary run folder
    assert "different from 0.2" in done.stdout


def test_what_if_takes_its_reference_from_the_log(runs):
    """A scenario with a reference of its own, a step, drives the logged sine."""
    change = ("--set", "fault.at_s=0.2", "--out", "step", "--json")
    log = runs / "a" / "bus.log"
    done = succeeded("replay", log, "--what-if", "--scenario", "thesis-step", *change)
    assert json.loads(done.stdout)["same"]
    assert Path("step/bus.log").read_bytes() == log.read_bytes()


def test_what_if_refuses_what_makes_no_sense(runs):
    unknown_delay = (
        "--set", "plant.force_difference_actuator.dead_time_s=0.002",
        "--set", "model.force_difference_actuator.dead_time_s=0",
    )  # fmt: skip
    for arguments, words in (
        (("--set", "reference.kind=step"), "that of the log"),
        (unknown_delay, "unstable"),
        (("--out", runs / "a", "--force"), "is the log itself"),
    ):
        assert words in refused("replay", runs / "a", "--what-if", *arguments)
        assert (runs / "a" / "bus.log").is_file()


def test_a_dollar_in_a_name_begins_no_formula(tmp_path):
    scenario, folder = tmp_path / "$_{$.toml", tmp_path / "a$_{$"
    scenario.write_text("duration_s = 0.05\n")
    done = asked("run", scenario, "--in-process", "--out", folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert asked("diff", folder, folder, "--out", tmp_path / "a.png").returncode == 0
