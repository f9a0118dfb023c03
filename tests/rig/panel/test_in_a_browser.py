"""The panel as a person has it: in a browser, with a mouse."""

import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import expect

from can_rig.logs.reading import read_log
from tests.browser import barriers
from tests.processes import start

STILL = {"specific_force_mps2", "lateral_acceleration_mps2"}  # columns that move without a push
LASTING = "--set", "fault.kind=none", "--set", "duration_s=600"  # also for a browser that lags


def panel(*arguments: str) -> tuple[subprocess.Popen, list[str]]:
    """``can-rig panel``, and the addresses in its output."""
    process = start("panel", *arguments)
    addresses = []
    for line in process.stdout:
        addresses += re.findall(r"http://\S+", line)
        if "only" in line:
            break
    return process, addresses


@pytest.mark.timeout(300)
def test_a_motor_that_is_killed_by_a_click_dies_again_in_the_saved_scenario(page, tmp_path):
    # The page keeps the last frames: with long ticks those of a longer time.
    process, (touch, _look) = panel("ideal", *LASTING, "--set", "tick_s=0.002")
    errors = []
    page.on("console", lambda message: message.type == "error" and errors.append(message.text))
    page.goto(touch)
    page.click("#start")
    expect(page.locator("#fault_state")).to_have_text("no fault")
    page.click("#trace summary")
    expect(page.locator(".frames tbody")).to_contain_text("CONTROLLER_STATUS")
    page.fill("#trace input", "rig_taken")
    page.click("#quick button >> nth=0")
    expect(page.locator(".frames tbody tr")).to_contain_text("Kind actuator-dead")
    expect(page.locator("#fault_state")).to_have_text("loss confirmed")
    expect(page.locator("#events")).to_contain_text("steering torque dead share 0")
    expect(page.locator("#fault_state")).to_have_class(re.compile("warn"))
    expect(page.locator("#verdict")).to_have_text(re.compile("lost"))
    expect(page.locator("#verdict")).to_have_class(re.compile("warn"))
    expect(page.locator("#events")).to_contain_text("fault state: confirmed")
    expect(page.locator("#events")).to_contain_text(re.compile("whose fault: steering torque"))
    marked = page.evaluate("charts.marks.map((each) => [each.text || each.kind, each.time_s])")
    (died,), (confirmed,) = (
        [time_s for text, time_s in marked if text == said]
        for said in ("actuator-dead", "fault state: confirmed")
    )
    assert died < confirmed  # a page on a busy machine sees the confirmation seconds late
    page.evaluate("addEvent({time_s: 0.0, action: 'STATE', text: 'a change that comes late'})")
    expect(page.locator("#events li").first).to_have_text(re.compile("a change that comes late"))
    ink = (
        page.locator("#charts canvas")
        .nth(3)
        .evaluate(
            "c => new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data).size"
        )
    )
    assert ink > 20  # a curve and its colours, not an empty frame
    page.click("#stop")
    expect(page.locator("#state")).to_contain_text("run folder")
    page.fill("#save-name", "by-hand")
    page.click("#save")
    expect(page.locator("#message")).to_have_text("saved as by-hand.toml")
    folder = Path(page.inner_text("#state").split()[-1].rstrip("."))
    heard = page.evaluate(
        "trace.frames.map((f) => [trace.kinds[f.kind].identifier, hex(f.data).join('')])"
    )
    process.terminate()
    assert process.wait(60) == 0
    assert errors == []

    shown = list(csv.DictReader((folder / "signals.csv").open()))
    ran = subprocess.run(
        [sys.executable, "-m", "can_rig", "run", "by-hand.toml", "--in-process", "--out", "again",
         "--set", f"duration_s={0.002 * len(shown):.3f}"],
        check=False, capture_output=True,
    )  # fmt: skip
    assert ran.returncode == 0
    logged = [
        (f"{message.arbitration_id:03X}", bytes(message.data).hex().upper())
        for frames in read_log(folder / "bus.log")
        for message in frames.messages()
    ]
    assert len(heard) > 5000
    recorded = {"100", "101", "110", "111", "120"}  # beside frames for the panel
    assert {(of, data) for of, data in heard if of in recorded} <= set(logged)
    again = list(csv.DictReader((tmp_path / "again" / "signals.csv").open()))
    world = set(shown[0]) - set(again[0])  # only a run that can be touched may yet be pushed
    assert {row[name] for row in shown for name in world - STILL} <= {"0", "0.0", "1", "1.0"}
    metrics = json.loads(Path("again/run.json").read_text("utf-8"))["metrics"]
    assert 0.0 < metrics["detection_delay_s"] < 0.2
    kept = [{name: row[name] for name in again[0]} for row in shown]
    assert again == kept
    assert sum((chunk.arbitration_id == 0x710).sum() for chunk in read_log(folder / "bus.log")) == 1


@pytest.mark.timeout(300)
def test_every_signal_is_listed_while_a_run_goes_on(page):
    process, (touch, _look) = panel("ideal", *LASTING)
    page.goto(touch)
    page.click("#start")
    expect(page.locator("#fault_state")).to_have_text("no fault")
    expect(page.locator("#bar > output")).to_contain_text("last values")
    assert page.evaluate(HIDDEN) <= 0  # the axis of the lowest chart, below a caption that grew
    page.select_option("#place", "world")
    expect(page.locator("#value")).not_to_have_attribute("placeholder", "default")
    page.click("#bar summary:text-is('Signals')")
    signal = page.locator("#bar .key:has-text('fault estimate')")
    expect(signal).to_have_text(re.compile(r"\d$"))
    signal.click()
    expect(page.locator(".chart")).to_have_count(6)
    page.click("[aria-label='remove the chart fault estimate'] >> nth=-1")
    assert barriers(page) == []
    page.click("#bar summary:text-is('Signals')")
    process.terminate()
    process.wait(60)


def test_who_may_look_only_finds_the_buttons_off(page):
    process, (_touch, look) = panel("ideal")
    page.goto(look)
    expect(page.locator("body")).to_have_attribute("data-state", "ready")
    expect(page.locator("#why")).to_have_text("This address may look only.")
    expect(page.locator("[data-order]:enabled")).to_have_count(0)
    process.terminate()
    process.wait(60)


HIDDEN = "charts.place.scrollHeight - charts.place.clientHeight"
ENABLED = "document.querySelectorAll('[data-order]:enabled').length"
HIGHER = "document.documentElement.scrollHeight - innerHeight"
WIDER = "document.documentElement.scrollWidth - innerWidth"


@pytest.mark.timeout(300)
def test_each_state_is_said_and_what_has_no_effect_is_disabled(page):
    process, (touch, _look) = panel("pendulum", *LASTING)
    page.goto(touch)

    def state(name: str, says: str) -> None:
        expect(page.locator("body")).to_have_attribute("data-state", name)
        expect(page.locator("#state")).to_contain_text(says)
        assert barriers(page) == []
        for width, height in ((390, 844), (1280, 800)):
            page.set_viewport_size({"width": width, "height": height})
            assert page.evaluate(WIDER) <= 0
        assert page.evaluate(HIGHER) <= 0

    state("ready", "Press Start")
    left = "charts.plots.map(({ plot }) => plot.bbox.left)"
    assert len(set(page.evaluate(left))) == 1  # one time axis, also without values
    expect(page.locator("#quick button").first).to_be_disabled()
    page.focus("#start")
    page.keyboard.press("Enter")
    state("running", "1 × real time")
    expect(page.locator("#start")).to_be_disabled()
    expect(page.locator("#quick button").first).to_have_text("Torque lost")
    page.focus("#move")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#events")).to_contain_text("move reference 0.005")
    expect(page.locator("#moved")).to_have_text("+0.005 rad")
    page.fill("#for", "0.3")
    page.click("#inject")
    expect(page.locator("#events")).to_contain_text("torque dead for 0.3 s")
    page.focus("#pause")
    page.keyboard.press("Enter")
    state("paused", "Go on")
    page.click("#step")
    page.click("#pause")
    state("running", "1 × real time")
    page.focus(".chart >> nth=0")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#bar > output")).to_contain_text("values at")
    page.keyboard.press("Enter")
    expect(page.locator("#bar > output")).to_contain_text("after the mark")
    page.click("#stop")
    state("ended", "was stopped")
    expect(page.locator("#save")).to_be_enabled()
    for values in (
        [1e-8, 1.0000001e-8], [1.0, 1.000001], [1.0, 1.0 + 2.0**-52], [0.0, 5e-324], [0.0, 0.0],
        [None, None],
    ):  # fmt: skip
        page.evaluate("v => charts.setData({time: [0, 1], output: v, reference: v})", values)
    process.terminate()
    assert process.wait(60) == 0
    state("gone", "program is gone")
    assert page.evaluate(ENABLED) == 0
