"""The commands of docs/logs.md, the README and the tutorials, run in their order."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from can_rig.assessment.tuning.candidate import grid
from can_rig.cli.main import main
from tests.helpers import decoded
from tests.project.pages import ROOT, TUTORIALS, blocks, command_lines, text_of

pytestmark = pytest.mark.reports

SHORT = ["--in-process", "--set", "duration_s=0.3", "--set", "fault.at_s=0.2"]
ANSWERS_NO = re.compile("can-rig diff .*|can-rig check thesis-step --set latency_ticks=1")
PROGRAMS = {"python": [sys.executable], "pytest": [sys.executable, "-m", "pytest"]}
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?")


def run_in_order(lines: list[str], *short: str) -> str:
    """Run each line, every run with the words ``short`` too; what all lines print."""
    printed = []
    for line in lines:
        program, *arguments = shlex.split(line)
        if program in PROGRAMS:
            command = [*PROGRAMS[program], *arguments]
            ended = subprocess.run(command, capture_output=True, text=True, check=False)
            status, output = ended.returncode, ended.stdout + ended.stderr
        else:
            words = [*arguments, *(short if arguments[0] == "run" else [])]
            done = CliRunner().invoke(main, words)
            status, output = done.exit_code, done.output
        assert status == bool(ANSWERS_NO.fullmatch(line)), f"{line}\n{output}"
        printed.append(output)
    return "".join(printed)


def same(line: str, other: str) -> bool:
    """Whether two lines have the same words, and numbers within 2 %."""
    words = [" ".join(NUMBER.sub("#", each).split()) for each in (line, other)]
    numbers = [[float(number) for number in NUMBER.findall(each)] for each in (line, other)]
    return words[0] == words[1] and numbers[1] == pytest.approx(numbers[0], rel=0.02)


def follow(text: str) -> None:
    """Save the files of a page, run its commands, and look for the output that the page prints."""
    printed = ""
    for language, block in re.findall(r"^```(\w+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        if language == "sh":
            printed = run_in_order(command_lines(f"```sh\n{block}```"), "--in-process")
        elif language == "text":
            for line in block.splitlines():
                assert any(same(line, other) for other in printed.splitlines()), (
                    f"{line}\n{printed}"
                )
        else:
            place = re.match(r"# (at the end of )?(\S+)\n", block)
            assert place, f"no file for\n{block}"
            with Path(place[2]).open("a" if place[1] else "w", encoding="utf-8") as file:
                file.write(block)


@pytest.fixture
def folder(tmp_path):
    """An empty working directory with the frames and the documentation."""
    for name in ("dbc", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def test_the_commands_and_the_example_of_the_log_page(folder):
    text = text_of("docs/logs.md")
    run_in_order([line for line in command_lines(text) if line.startswith("can-rig ")], *SHORT)
    for name in ("demo.csv", "demo.mf4", "gaps.csv", "demo.png", "apart.png"):
        assert (folder / name).stat().st_size > 0
    assert (folder / "runs" / "other" / "what-if.png").is_file()
    names: dict[str, Any] = {}
    exec("\n".join(blocks(text, "python")), names)
    expected = decoded(folder / "runs" / "demo" / "bus.log")["DSTAR_FEEDBACK"].tolist()
    assert names["table"]["DStar"].tolist() == expected


def test_the_commands_of_the_readme(folder):
    lines = command_lines(text_of("README.md"))
    run_in_order([line for line in lines if line.startswith("can-rig ")], *SHORT)
    what_if = json.loads((folder / "runs" / "uncompensated" / "run.json").read_text("utf-8"))
    assert what_if["scenario"]["design"]["compensation"] == "off"


@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_runs_as_printed(name, folder, monkeypatch):
    few = "can_rig.assessment.tuning.search.grid"  # the whole grid takes long
    monkeypatch.setattr(few, lambda scenario: grid(scenario)[::12])
    follow(text_of(f"docs/{name}"))
    assert {path.name for path in folder.glob("*.html")} == set(
        re.findall(r"--out (\S+\.html)", text_of(f"docs/{name}"))
    )
