"""``can-rig campaign``: a table, a report that a person can open, and one line for bad input."""

import base64
import html
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from can_rig.campaigns.settings import shipped
from tests.helpers import asked

FEW = ("--set", "duration_s=0.3", "--set", "fault.at_s=0.2", "--workers", "1")
OWN = """
description = "a < b & c"
runs = 6
[settings]
duration_s = 0.3
fault.at_s = 0.2
fault.kind = "actuator-dead"
[axes]
"fault.channel" = {{ values = ["torque", "force-difference"] }}
"fault.left" = {{ range = [0.0, 0.5] }}
[requirements]
bound = "deviation_peak_after_fault_mps2 <= {bound}"
"""


class Page(HTMLParser):
    """Tags that are open, and the pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.pictures: list[bytes] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            encoded = (dict(attrs)["src"] or "").partition("base64,")[2]
            self.pictures.append(base64.b64decode(encoded))
        elif tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize(("bound", "status"), [(1e3, 0), (-1.0, 1)])
def test_a_campaign_leaves_table_report_and_summary(bound, status, tmp_path):
    (tmp_path / "own.toml").write_text(OWN.format(bound=bound))
    out = Path("s3:out")  # a folder, and no address of pyarrow's
    done = asked("campaign", tmp_path / "own.toml", "--out", out, "--workers", 1)
    assert done.returncode == status, done.stderr
    assert {path.name for path in out.iterdir()} == {
        "campaign.json", "runs.parquet", "report.html", "report.png", "summary.json",
    }  # fmt: skip
    summary = json.loads((out / "summary.json").read_text())
    assert summary["rates"][0]["passed" if status == 0 else "failed"] == 6
    page = Page()
    text = (out / "report.html").read_text("utf-8")
    page.feed(text)
    assert page.open == []
    assert [picture[:4] for picture in page.pictures] == [b"\x89PNG"]
    assert "a &lt; b &amp; c" in text
    for word in (summary["worst"][0]["command"], "fault.left", "bound"):
        assert html.escape(word) in text
        assert word in done.stdout or word == "fault.left"
    # Once more the report of a campaign that is done.
    again = asked("campaign", tmp_path / "own.toml", "--out", out, "--resume", "--json")
    assert again.returncode == status
    assert json.loads(again.stdout)["rates"] == summary["rates"]


def test_a_shipped_campaign_by_name(tmp_path):
    done = asked("campaign", "losses", "--runs", 2, *FEW, "--set", "reference.kind=step",
                 "--seed", 4, "--scenario", "ideal", "--out", tmp_path / "out")  # fmt: skip
    assert done.returncode in {0, 1}, done.stderr
    said = json.loads((tmp_path / "out" / "campaign.json").read_text())
    assert said["scenario"]["ideal"]["name"] == "ideal"
    assert (said["campaign"]["runs"], said["campaign"]["seed"]) == (2, 4)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["nothing"], "no such campaign and no such file"),
        (["cars", "--resume"], "--resume: must come with --out"),
        (["cars", "--runs", "3"], "runs = 3: must not be set for a grid"),
        (["cars", "--set", "plant.mas=1"], "mas: unknown key"),
        (["cars", "--workers", "0"], "0 is not in the range"),
        (["cars", "--out", ".."], "there already"),
    ],
)
def test_bad_input_is_one_line(arguments, line, tmp_path):
    done = asked("campaign", *arguments)
    assert done.returncode == 2
    assert line in re.sub(r"\s+", " ", done.stderr)
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


NAMES = """
runs = 6
[settings]
duration_s = 0.3
fault.at_s = 0.2
[choices."fault.0"]
"{odd} lost" = {{ kind = "actuator-dead" }}
"{odd} half" = {{ kind = "actuator-dead", left = 0.5 }}
[requirements]
"{odd}" = "deviation_peak_after_fault_mps2 <= 1e-9"
[tables.verdicts]
rows = "fault.0"
"""


def test_names_are_no_markup_and_no_formulas(tmp_path):
    odd = "[/red] $\\foo$ [m]"
    (tmp_path / "own [b].toml").write_text(NAMES.format(odd=odd.replace("\\", "\\\\")))
    done = asked("campaign", tmp_path / "own [b].toml", "--scenario", "ideal", "--workers", 1,
                 "--out", tmp_path / "out")  # fmt: skip
    assert done.returncode == 1, done.stderr
    said = [line.split("  ")[0] for line in done.stdout.splitlines()]
    assert {odd, f"{odd} lost", f"{odd} half"} <= {*said}


@pytest.mark.filterwarnings("error")
def test_requirements_that_no_run_decides_are_no_warning(tmp_path):
    (tmp_path / "own.toml").write_text(
        "runs = 2\n[settings]\nduration_s = 0.3\nfault.at_s = 0.5\n"
        "[requirements]\nfound = 'not missed_detection'\n"
    )
    done = asked("campaign", tmp_path / "own.toml", "--out", tmp_path / "out", "--workers", 1)
    assert (done.returncode, done.stderr) == (0, "")


def test_all_runs_without_a_result_are_counted_whatever_their_reasons(tmp_path):
    (tmp_path / "own.toml").write_text(
        "sampling = 'grid'\n[settings]\nduration_s = 0.3\nfault.at_s = 0.2\n"
        "[axes]\n'plant.mass_kg' = { values = [1400, -1, -2, -3, -4, -5] }\n"
    )
    done = asked("campaign", tmp_path / "own.toml", "--out", tmp_path / "out", "--workers", 1)
    assert done.returncode == 1, done.stderr
    assert "5 of 6 runs have no result" in done.stdout.splitlines()
    assert "plant.mass_kg = -1: must be" in done.stdout


def test_a_row_without_a_decided_run_does_not_look_like_a_row_without_a_failure(tmp_path):
    (tmp_path / "own.toml").write_text(
        "sampling = 'grid'\n[settings]\nduration_s = 0.3\nfault.at_s = 0.2\n"
        "[axes]\n'plant.mass_kg' = { values = [1400, -1] }\n"
        "[requirements]\nx = 'torque_peak_nm > 0'\n[tables.t]\nrows = 'plant.mass_kg'\n"
    )
    done = asked("campaign", tmp_path / "own.toml", "--out", tmp_path / "out", "--workers", 1)
    lines = [line.split() for line in done.stdout.splitlines()]
    assert ["-1.0", "1", "-"] in lines
    assert ["1400.0", "1"] in lines
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert re.search(r"<td>-1.0</td><td[^>]*>1</td><td[^>]*>-</td>", page)


def test_the_help_names_every_shipped_campaign():
    said = asked("campaign", "--help").stdout
    assert f"a shipped one: {', '.join(sorted(shipped()))}." in " ".join(said.split())
