"""``tools/website``: a site from the documentation, the code and the scenarios' own runs."""

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import click
import pytest
import website

import can_rig
from can_rig.cli.main import main
from tests.browser import barriers
from tests.helpers import succeeded
from tests.project.pages import PAGES, ROOT


class Text(HTMLParser):
    """The text of a page, its headings, and the formulas in it."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.text, self.formulas, self.anchors = "", 0, set()
        self.feed(page.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.formulas += tag == "math"
        self.anchors |= {value for name, value in attrs if name == "id"}

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site with a gallery of one scenario."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(website, "BUILD", tmp_path_factory.mktemp("site"))
        website.main(["pendulum"])
        return website.BUILD / "site"


@pytest.mark.timeout(300)
def test_every_page_command_and_name_of_python_is_in_the_site(site):
    for page in PAGES:
        path = page.relative_to(ROOT)
        name = "index.html" if page.name == "README.md" else f"{page.stem}.html"
        assert (site / path.parent / name).is_file(), path
    commands = Text(site / "reference" / "commands.html").text
    for name in main.list_commands(click.Context(main)):
        assert f"can-rig {name} [OPTIONS]" in commands
        for option in main.get_command(click.Context(main), name).params:
            if isinstance(option, click.Option) and not option.hidden:
                assert option.opts[-1] in commands
    python = Text(site / "reference" / "python.html").anchors
    for name in can_rig.__all__:
        of = getattr(can_rig, name)
        assert f"{of.__module__}.{of.__qualname__}" in python


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", ["index", "docs/design", "reference/python", "gallery/pendulum"])
def test_no_page_has_a_barrier_or_is_wider_than_a_phone(site, name, page):
    page.goto((site / f"{name}.html").as_uri())
    page.wait_for_selector(".md-code__nav[aria-label]", state="attached")
    assert barriers(page) == []
    hidden = (
        "[...document.querySelectorAll('.formula')].map((f) => f.scrollHeight - f.clientHeight)"
    )
    assert max(page.evaluate(hidden), default=0) <= 0
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


def test_a_name_with_an_asterisk_begins_no_emphasis(site):
    for page in [site / "index.html", *(site / "docs").glob("*.html")]:
        assert not re.search(r"\w<em>", page.read_text("utf-8")), page


def test_formulas_are_drawn_without_a_script(site):
    design = Text(site / "docs" / "design.html")
    written = (ROOT / "docs" / "design.md").read_text("utf-8")
    assert design.formulas > written.count("```math")
    assert "\\hat" not in design.text
    assert "(2.33, 2.34)" in design.text


def test_the_numbers_of_the_gallery_are_those_of_a_run(site, tmp_path):
    succeeded("run", "pendulum", "--in-process", "--out", tmp_path / "run")
    metrics = json.loads((tmp_path / "run" / "run.json").read_text("utf-8"))["metrics"]
    said = Text(site / "gallery" / "pendulum.html").text
    assert f"{metrics['detection_delay_s']:.4g} s" in said
    assert f"{metrics['deviation_peak_after_fault_mps2']:.4g} rad" in said
    report = (site / "gallery" / "pendulum" / "report.html").read_text("utf-8")
    assert "torque lost" in report


def test_broken_links_and_anchors_fail_the_build(tmp_path, monkeypatch):
    for name in (*website.COPIED, "tools"):
        if name == "docs":
            shutil.copytree(ROOT / name, tmp_path / name)
        else:
            (tmp_path / name).symlink_to(ROOT / name)
    with (tmp_path / "docs" / "logs.md").open("a", encoding="utf-8") as page:
        page.write("\n[away](nowhere) [no](scenarios.md#no-heading)\n")
    monkeypatch.setattr(website, "ROOT", tmp_path)
    monkeypatch.setattr(website, "BUILD", tmp_path / "build")
    monkeypatch.setattr(
        website, "write_gallery", lambda to, _: _empty_pages(to, "index", "pendulum")
    )
    monkeypatch.setattr(
        website, "write_reference", lambda to: _empty_pages(to, "commands", "python")
    )
    with pytest.raises(SystemExit) as broken:
        website.main(["pendulum"])
    assert "Aborted with 2 warnings" in str(broken.value)
    assert "nowhere" in str(broken.value)
    assert "no-heading" in str(broken.value)


def _empty_pages(folder: Path, *names: str) -> None:
    folder.mkdir()
    for name in names:
        (folder / f"{name}.md").write_text(f"# {name}\n", "utf-8")


def test_an_unknown_scenario_is_refused():
    with pytest.raises(SystemExit, match="scenario nothing: must be one of"):
        website.main(["nothing"])


def test_a_formula_in_code_and_a_price_stay_as_they_are():
    text = "`$x$` and\n```sh\necho $HOME $PATH\n```\n"
    assert website.with_mathml(text) == text
