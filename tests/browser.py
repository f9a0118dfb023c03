"""The browser of tests of a page."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")

PATIENCE_MS = 90_000
"""Of every click and expectation: a busy machine compiles and draws slowly."""


@pytest.fixture(scope="module")
def browser():
    """Chromium without a window."""
    if BROWSER is None:
        pytest.skip("NOT TESTED: there is no chromium here (apt-get install chromium)")
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def page(browser):
    """A page in which no script may fail."""
    errors: list[str] = []
    opened = browser.new_page(viewport={"width": 1280, "height": 800})
    opened.set_default_timeout(PATIENCE_MS)
    opened.on("pageerror", lambda error: errors.append(str(error)))
    yield opened
    opened.close()
    assert errors == []


def barriers(page: Page) -> list[str]:
    """What keeps someone from using the page in light or dark colours, as axe-core finds it."""
    from axe_playwright_python.sync_playwright import Axe

    found = []
    for colours in ("light", "dark"):
        page.emulate_media(color_scheme=colours)  # type: ignore[arg-type]
        found += [f"{each['id']}, {colours}" for each in Axe().run(page).response["violations"]]
    return found
