"""The panel as a person has it: in a browser, with a mouse."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import expect, sync_playwright

from can_rig.logs.reading import read_log
from tests.processes import start

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
PATIENCE_MS = 90_000  # a busy machine compiles


@pytest.fixture
def page():
    if BROWSER is None:
        pytest.skip("NOT TESTED: there is no chromium here (apt-get install chromium)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        opened = browser.new_page(viewport={"width": 1280, "height": 900})
        opened.set_default_timeout(PATIENCE_MS)
        yield opened
        browser.close()


def panel(*arguments: str) -> tuple[subprocess.Popen, list[str]]:
    """``can-rig panel``, and the addresses that it says."""
    process = start("panel", *arguments)
    addresses = []
    for line in process.stdout:
        addresses += re.findall(r"http://\S+", line)
        if "only" in line:
            break
    return process, addresses


@pytest.mark.timeout(300)
def test_a_motor_that_is_killed_by_a_click_dies_again_in_the_saved_scenario(page, tmp_path):
    process, (touch, _look) = panel("ideal", "--set", "fault.kind=none", "--set", "duration_s=60")
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: message.type == "error" and errors.append(message.text))
    page.goto(touch)
    page.click("#start")
    expect(page.locator("#fault_state")).to_have_text("no fault", timeout=PATIENCE_MS)
    page.click("#motor-dead")
    expect(page.locator("#fault_state")).to_have_text("loss confirmed", timeout=PATIENCE_MS)
    expect(page.locator("#events")).to_contain_text("actuator-dead torque 0")
    expect(page.locator("#fault_state")).to_have_class(re.compile("warn"))
    expect(page.locator("#verdict")).to_have_text(re.compile("lost"), timeout=PATIENCE_MS)
    expect(page.locator("#verdict")).to_have_class(re.compile("warn"))
    ink = (
        page.locator("#charts canvas")
        .nth(3)
        .evaluate(
            "c => new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data).size"
        )
    )
    assert ink > 20  # a curve and its colours, not an empty frame
    page.click("#stop")
    expect(page.locator("#folder")).to_contain_text("run folder", timeout=PATIENCE_MS)
    page.fill("#save-name", "by-hand")
    page.click("#save")
    expect(page.locator("#message")).to_have_text("saved as by-hand.toml")
    folder = Path(page.inner_text("#folder").split()[-1])
    process.terminate()
    assert process.wait(60) == 0
    assert errors == []

    ran = subprocess.run(
        [sys.executable, "-m", "can_rig", "run", "by-hand.toml", "--in-process", "--out", "again"],
        check=False, capture_output=True,
    )  # fmt: skip
    assert ran.returncode == 0
    shown = (folder / "signals.csv").read_bytes().splitlines()
    again = (tmp_path / "again/signals.csv").read_bytes().splitlines()
    assert again[: len(shown)] == shown  # it was stopped; the saved one runs on
    assert sum((chunk.arbitration_id == 0x710).sum() for chunk in read_log(folder / "bus.log")) == 1


def test_who_may_look_only_finds_the_buttons_off(page):
    process, (_touch, look) = panel("ideal")
    page.goto(look)
    expect(page.locator("#connection")).to_have_text("connected")
    for button in ("start", "pause", "motor-dead", "save"):
        expect(page.locator(f"#{button}")).to_be_disabled()
    process.terminate()
    process.wait(60)
