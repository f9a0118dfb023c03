"""``report.html``: everything in one file, the numbers as they were, no peak lost."""

import base64
import json
import re
import zlib
from typing import Any

import numpy as np
import pytest

from can_rig.drawing.bench import packed
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.metrics import fault_metrics, metrics
from can_rig.results.report.web_page import events, recording, web_page
from can_rig.results.signals import Signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load

SHORT = ["duration_s=1.5", "fault.at_s=0.8", "fault.1.kind=frames-missing", "fault.1.at_s=0.2"]
SHORT += ["fault.1.channel=sensor", "fault.1.for_s=0.05", "description=</script>"]
SHORT += ["disturbance={kind='gust', at_s=0.3, for_s=0.2, force_n=50}"]


@pytest.fixture(scope="module")
def ran():
    scenario = load("default", SHORT)
    signals = signals_without_log(scenario)
    values, faults = metrics(scenario, signals), fault_metrics(scenario, signals)
    page = web_page(scenario, network_of(scenario), signals, values, faults, scenario)
    return scenario, signals, page


def numbers(run: dict[str, Any]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time, and curves by key, as the page unpacks them."""
    raw, points = zlib.decompress(base64.b64decode(run["data"])), run["points"]
    single = np.frombuffer(raw[8 * points :], "<f4").reshape(len(run["keys"]), points)
    return np.frombuffer(raw[: 8 * points], "<f8"), dict(zip(run["keys"], single, strict=True))


def test_the_page_needs_nothing_but_itself(ran):
    page = ran[2]
    assert not re.findall(r"(?:src|href|import|url)\s*[=(]\s*[\"']?(?!data:)(?:https?:)?//", page)
    assert page.count("<script") == page.count("</script>") == 6
    assert "uPlot=function" in page


def test_the_numbers_are_those_of_the_run(ran):
    _, signals, page = ran
    found = re.search(r'id="run">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    run = json.loads(found[1])
    time_s, curves = numbers(run)
    np.testing.assert_array_equal(time_s, signals.time_s)
    np.testing.assert_array_equal(curves["output"], signals.dstar_mps2.astype(np.float32))
    assert np.isnan(curves["output"]).sum() == 50  # of the frames that were missing
    np.testing.assert_array_equal(curves["command_1"], signals.torque_nm.astype(np.float32))
    shown = {key for chart in run["charts"] for key in chart["keys"]}
    assert shown == {curve["key"] for curve in run["curves"]} == set(curves)
    assert [(shade["begin"], shade["end"]) for shade in run["shades"]] == [
        (0.8, None),
        (0.2, 0.25),
        (0.3, 0.5),
    ]


def test_the_page_says_what_happened_and_what_was_run(ran):
    scenario, signals, page = ran
    for text in (
        "detection_delay_s", "<td>detection delay</td>", "<td>s</td>", "fault.1.channel",
        "default: 2 faults", "gust of 50 N from 0.3 s to 0.5 s", "plant.speed_mps",
    ):  # fmt: skip
        assert text in page
    said = [(round(e.time_s, 6), e.text) for e in events(scenario, network_of(scenario), signals)]
    assert (0.2, "fault begins: D* lost") in said
    assert (0.25, "fault ends: D* lost") in said
    assert (0.2, "mode: blind") in said
    assert (0.3, "disturbance begins: gust of 50 N") in said
    assert (0.5, "disturbance ends: gust of 50 N") in said
    assert (0.8, "fault begins: steering torque lost") in said
    suspected = [time_s for time_s, text in said if text == "fault state: suspected"]
    assert suspected
    assert suspected[-1] > 0.8
    assert said == sorted(said, key=lambda event: event[0])


def test_a_long_run_has_few_points_and_every_peak(monkeypatch):
    monkeypatch.setattr("can_rig.drawing.bench.MOST_POINTS", 100)
    scenario = load("ideal", ["duration_s=1.013"])
    signals = signals_without_log(scenario)
    time_s, curves = numbers(packed(recording(scenario, network_of(scenario), signals)))
    assert len(time_s) <= 100
    assert (np.diff(time_s) > 0.0).all()
    for key, values in (("output", signals.dstar_mps2), ("command_1", signals.torque_nm)):
        assert curves[key].max() == np.float32(values.max())
        assert curves[key].min() == np.float32(values.min())


def test_a_run_without_a_tick_has_a_page():
    scenario = load("ideal", ["duration_s=0.1"])
    empty = Signals(*(np.empty(0) for _ in range(8)))
    page = web_page(scenario, network_of(scenario), empty, metrics(scenario, empty), [], scenario)
    assert "Metrics" in page


def test_metrics_have_the_names_of_the_plant():
    scenario = load("two-masses", ["duration_s=3", "fault.at_s=1.5"])
    signals = signals_without_log(scenario)
    values, faults = metrics(scenario, signals), fault_metrics(scenario, signals)
    page = web_page(scenario, network_of(scenario), signals, values, faults, scenario)
    said = re.findall(r"<tr><td[^>]*>([^<]*)</td>", page.partition("<summary>Scenario")[0])
    assert {"force 1 peak", "force 2 settled"} <= set(said)
    assert not [words for words in said if re.search("torque|difference|dstar", words)]
    assert len(re.findall(r"<td>place</td><td[^>]*>force 1</td>", page)) == 2


def test_the_integral_of_an_error_has_the_unit_of_the_plant():
    scenario = load("satellite", ["duration_s=2.0", "fault.at_s=1.0"])
    signals = signals_without_log(scenario)
    page = web_page(
        scenario, network_of(scenario), signals, metrics(scenario, signals), (), scenario
    )
    row = re.search(r"<tr>(?:(?!</tr>).)*error_integral_after_fault_mps.*?</tr>", page, re.DOTALL)
    assert "rad s" in row[0]
    assert "m/s" not in row[0]
