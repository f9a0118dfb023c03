"""Pages compared with screenshots of before: three sizes, light and dark.

A screenshot is compared as a picture of coarse points, because edges of letters and curves differ
between browsers. After an intended change ``CAN_RIG_SCREENSHOTS=renew`` writes the screenshots
again; look at the pages before you commit.
"""

import io
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.helpers import asked
from tests.rig.panel.test_in_a_browser import panel

pytestmark = pytest.mark.reports

KEPT = Path(__file__).parent / "screenshots"
SIZES = {"phone": (390, 844), "laptop": (1280, 800), "monitor": (1920, 1080)}
CELL = 20  # pixels of a coarse point
MOST = 0.05  # difference of a point, of black to white; 0.003 from run to run
WIDTH_PX = 435.2  # of a text in DejaVu Sans, Debian's usual font


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The address of each page by name."""
    folder = tmp_path_factory.mktemp("pages")
    run = ["run", "default", "--in-process", "--set", "duration_s=1.5", "--set", "fault.at_s=0.5"]
    assert asked(*run, "--out", folder / "run").returncode == 0
    assert asked("view", folder / "run", "--out", folder / "view.html").returncode == 0
    files = {"view": folder / "view.html", "report": folder / "run" / "report.html"}
    return {name: file.as_uri() for name, file in files.items()}


def coarse(png: bytes) -> np.ndarray:
    """A screenshot as few points: (rows, columns, 3), 0 to 1."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    size = (picture.width // CELL, picture.height // CELL)
    return np.asarray(picture.resize(size, Image.Resampling.BOX), float) / 255.0


def kept(name: str, found: np.ndarray) -> np.ndarray:
    """The screenshot of before; renewed where the environment asks."""
    file = KEPT / f"{name}.png"
    if os.environ.get("CAN_RIG_SCREENSHOTS") == "renew":
        KEPT.mkdir(exist_ok=True)
        Image.fromarray((found * 255.0).round().astype(np.uint8)).save(file, optimize=True)
    return np.asarray(Image.open(file), float) / 255.0


def shot(page, address: str, size: str, colours: str) -> bytes:
    width, height = SIZES[size]
    page.emulate_media(color_scheme=colours, reduced_motion="reduce")
    page.set_viewport_size({"width": width, "height": height})
    page.goto(address)
    page.wait_for_selector("body[data-drawn], body[data-state=ready]")
    page.wait_for_timeout(300)  # charts follow their size with the next frame
    return page.screenshot()


WIDTH = """() => {
  const drawing = document.createElement('canvas').getContext('2d');
  drawing.font = '40px system-ui';
  return drawing.measureText('steering torque 0.123').width;
}"""


BOXES = """() => [...document.querySelectorAll('body *')].map((each) => {
  const box = each.getBoundingClientRect();
  return [each.tagName, each.id, box.x, box.y, box.width, box.height].join(' ');
})"""


def check(page, name: str, address: str) -> None:
    """Compare the page in each size and in each colour scheme, which moves nothing."""
    off = {}
    for size in SIZES:
        places = []
        for colours in ("light", "dark"):
            png = shot(page, address, size, colours)
            places.append(page.evaluate(BOXES))
            if abs(page.evaluate(WIDTH) - WIDTH_PX) > 1.0:
                pytest.skip("NOT TESTED: pages have another font here than DejaVu Sans")
            found = coarse(png)
            before = kept(f"{name}-{size}-{colours}", found)
            assert found.shape == before.shape
            off[f"{size}, {colours}"] = np.abs(found - before).mean(axis=2).max()
        assert places[0] == places[1]
    assert {page: each for page, each in off.items() if each > MOST} == {}


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", ["view", "report"])
def test_a_page_looks_as_before(page, pages, name):
    check(page, name, pages[name])


@pytest.mark.timeout(120)
def test_the_panel_before_its_start_looks_as_before(page):
    process, (touch, _look) = panel("default")
    check(page, "panel", touch)
    process.terminate()
    process.wait(60)
