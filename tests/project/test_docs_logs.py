"""The commands of docs/logs.md and of the README, run in their order."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from can_rig.cli.main import main
from tests.helpers import decoded
from tests.project.pages import ROOT, blocks, command_lines, text_of

SHORT = ["--in-process", "--set", "duration_s=0.3", "--set", "fault.at_s=0.2"]
ANSWERS_NO = {"diff"}  # two controllers do differ


def run_in_order(lines: list[str]) -> None:
    for line in lines:
        _, name, *arguments = shlex.split(line)
        short = SHORT if name == "run" else []
        done = CliRunner().invoke(main, [name, *arguments, *short])
        assert done.exit_code == (1 if name in ANSWERS_NO else 0), f"{line}\n{done.output}"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory with the frames."""
    (tmp_path / "dbc").symlink_to(ROOT / "dbc")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_commands_and_the_example_of_the_log_page(folder: Path) -> None:
    text = text_of("docs/logs.md")
    run_in_order([line for line in command_lines(text) if line.startswith("can-rig ")])
    for name in ("demo.csv", "demo.mf4", "gaps.csv", "demo.png", "apart.png"):
        assert (folder / name).stat().st_size > 0
    assert (folder / "runs" / "other" / "what-if.png").is_file()
    names: dict[str, Any] = {}
    exec("\n".join(blocks(text, "python")), names)
    expected = decoded(folder / "runs" / "demo" / "bus.log")["DSTAR_FEEDBACK"].tolist()
    assert names["table"]["DStar"].tolist() == expected


def test_the_commands_of_the_readme(folder: Path) -> None:
    lines = command_lines(text_of("README.md"))
    run_in_order([line for line in lines if line.startswith("can-rig ")])
    what_if = json.loads((folder / "runs" / "uncompensated" / "run.json").read_text("utf-8"))
    assert what_if["scenario"]["design"]["compensation"] == "off"
