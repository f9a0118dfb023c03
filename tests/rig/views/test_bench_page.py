"""The page of a run or a log: every signal, no peak lost, in a browser."""

import json
import re
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, strategies as st
from playwright.sync_api import expect

from can_rig.drawing.bench import on_one_axis
from can_rig.storage import paged
from tests.browser import barriers
from tests.helpers import asked, succeeded

pytestmark = pytest.mark.reports

TIME_S = st.integers(0, 9000).map(lambda ms: ms / 1000)
CURVE = st.lists(st.tuples(TIME_S, st.floats(-1e6, 1e6)), min_size=1, max_size=60)


@given(st.lists(CURVE, min_size=1, max_size=3), st.integers(4, 50))
def test_a_common_axis_keeps_the_extremes_of_each_part_and_invents_nothing(curves, points):
    """Of curves whose clocks may be set back."""
    made = [np.array(curve).T for curve in curves]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("can_rig.drawing.bench.MOST_POINTS", points)
        patch.setattr(paged, "BLOCK_ROWS", 7)  # a part may end in the next block
        time_s, columns = on_one_axis([(t, v) for t, v in made])
    assert len(time_s) <= points
    assert (np.diff(time_s) > 0.0).all()
    parts = min(points // 2, sum(len(t) for t, _ in made))
    width = (max(t.max() for t, _ in made) - min(t.min() for t, _ in made)) or parts
    for (times, values), column in zip(made, columns, strict=True):
        known = np.isfinite(column)
        assert {values.min(), values.max()} <= set(column[known])
        for at, value in zip(time_s[known], column[known], strict=True):
            assert value in values[np.abs(times - at) <= 1.001 * width / parts + 1e-9]


def test_short_curves_keep_every_point_across_an_hour():
    """Two bursts of two signals with an hour between: equal parts would merge each burst."""
    burst = np.arange(200) * 1e-3
    first_s = np.concatenate([burst, 3600.0 + burst])
    second_s = first_s[::4] + 1e-4
    made = [(first_s, np.sin(7.0 * first_s)), (second_s, np.cos(second_s))]
    time_s, columns = on_one_axis(made)
    for (times, values), column in zip(made, columns, strict=True):
        known = np.isfinite(column)
        assert time_s[known].tolist() == times.tolist()
        assert column[known].tolist() == values.tolist()


def test_no_copy_of_a_long_curve_is_in_memory(monkeypatch):
    monkeypatch.setattr("can_rig.drawing.bench.MOST_POINTS", 100)
    long = np.arange(300_000.0)
    tracemalloc.start()
    on_one_axis([(long, long)])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < long.nbytes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("view")
    settings = "--set", "duration_s=1.5", "--set", "fault.at_s=0.5"
    succeeded("run", "default", *settings, "--in-process", "--out", path / "run")
    return path


def shown(page: str) -> dict:
    return json.loads(re.search(r'id="run">(.*?)</script>', page, re.DOTALL)[1])


def test_a_run_has_its_charts_and_the_evidence_and_reports_beside(folder):
    assert asked("view", folder / "run", "--out", folder / "run.html").returncode == 0
    run = shown((folder / "run.html").read_text("utf-8"))
    labels = {curve["label"]: curve["unit"] for curve in run["curves"]}
    assert labels["yaw rate"] == "rad/s"
    assert "evidence: steering torque lost" in labels
    assert run["scene"]["kind"] == "car"
    assert [mark["time_s"] for mark in run["marks"] if "fault begins" in mark["text"]] == [0.5]


def test_a_log_has_the_signals_of_its_database(folder):
    succeeded("view", folder / "run/bus.log", "--out", folder / "log.html")
    run = shown((folder / "log.html").read_text("utf-8"))
    assert "DSTAR_FEEDBACK.DStar" in run["keys"]
    (mode,) = (curve for curve in run["curves"] if curve["key"] == "CONTROLLER_STATUS.Mode")
    assert "RUN" in mode["words"].values()
    nothing = asked("view", folder / "run/bus.log", "--dbc", "dbc/control.dbc", "--out", "x.html")
    assert nothing.returncode != 0


def test_an_existing_page_stays(folder):
    (folder / "there.html").write_text("mine")
    done = asked("view", folder / "run", "--out", folder / "there.html")
    assert "exists; choose" in done.stderr
    assert (folder / "there.html").read_text() == "mine"


@pytest.mark.timeout(120)
def test_in_a_browser_charts_are_added_and_zoom_together_and_an_event_is_found(page, folder):
    asked("view", folder / "run", "--out", folder / "page.html", "--force")
    page.goto((folder / "page.html").as_uri())
    page.wait_for_selector("body[data-drawn]")
    before = page.locator(".chart").count()
    page.click("#list button:has-text('yaw rate')")
    expect(page.locator(".chart")).to_have_count(before + 1)
    page.click(".chart:last-child button:has-text('×')")
    expect(page.locator(".chart")).to_have_count(before)
    page.click("#marks button:has-text('fault begins')")
    expect(page.locator("#bar output")).to_contain_text("values at 0.500 s")
    expect(page.locator("#scene")).to_have_attribute("aria-label", re.compile("torque lost"))
    page.focus(".chart >> nth=0")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#bar output")).to_contain_text("after the mark")
    expect(page.locator(".u-cursor-x >> nth=0")).to_be_visible()
    expect(page.locator(".u-cursor-y >> nth=0")).to_be_hidden()  # a time has no height
    assert barriers(page) == []
    page.select_option("#play select", "10")
    page.click("#play button")
    expect(page.locator("#play button")).to_have_text("Play", timeout=20_000)  # at its end
    expect(page.locator("#scene")).to_have_attribute("aria-label", re.compile("^1.4"))
    page.goto((folder / "run" / "report.html").as_uri())
    page.wait_for_selector("body[data-drawn]")
    assert barriers(page) == []


def test_in_a_browser_every_signal_of_a_log_has_its_last_value(page, folder):
    """No two frames of a log come at the same time."""
    asked("view", folder / "run/bus.log", "--out", folder / "last.html", "--force")
    page.goto((folder / "last.html").as_uri())
    page.wait_for_selector("body[data-drawn]")
    page.focus("#play input")
    page.keyboard.press("End")
    expect(page.locator("#bar output")).to_contain_text("values at 1.499 s")
    assert "–" not in page.inner_text("#list")


def test_a_drag_over_a_chart_shows_the_time_under_the_drag_in_every_chart(page, folder):
    asked("view", folder / "run", "--out", folder / "page.html", "--force")
    page.goto((folder / "page.html").as_uri())
    page.wait_for_selector("body[data-drawn]")

    def time_s(chart: int, share: float) -> float:
        box = page.locator(".u-over").nth(chart).bounding_box()
        page.mouse.move(box["x"] + share * (box["width"] - 1), box["y"] + 9)
        (found,) = re.findall(r"values at (\S+) s", page.inner_text("#bar output"))
        return float(found)

    for ticks, step in (
        ([35.9999, 36, 36.0001], 1e-4), ([0, 2.5, 5], 2.5), ([0, 2e4, 4e4], 2e4), ([0, 1e-9], 1e-9),
    ):  # fmt: skip
        said = page.evaluate("([v, step]) => numbers(null, v, null, null, step)", [ticks, step])
        assert [float(each.replace(",", "")) for each in said] == ticks
    begin_s, end_s = time_s(1, 0.2), time_s(1, 0.4)
    page.mouse.down()
    time_s(1, 0.2)
    page.mouse.up()
    for chart in (0, 1, 4):
        assert abs(time_s(chart, 0.0) - begin_s) < 0.004
        assert abs(time_s(chart, 1.0) - end_s) < 0.004
