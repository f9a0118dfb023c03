"""What the README says can be typed, can be typed."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import click
import pytest

from can_rig.assessment.resolve import load, resolve
from can_rig.cli.main import COMMANDS, main
from can_rig.results.run_folder import LOG, REPORT, SIGNALS, SUMMARY
from can_rig.scenario.loading import draft
from firmware_model.target.layout import Mode
from tests.helpers import decoded, record

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """The fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


LINES = [line.split("#")[0].strip() for block in blocks("sh") for line in block.splitlines()]
RIG = [line for line in LINES if line.startswith("can-rig ")]
TOOLS = [line.split()[0] for line in LINES if line.startswith("./tools/")]


@pytest.mark.parametrize("line", RIG)
def test_a_command_parses_and_its_scenario_loads(line: str) -> None:
    _, name, *arguments = shlex.split(line)
    command = main.get_command(click.Context(main), name)
    assert command is not None
    context = command.make_context(name, list(arguments))
    if "scenario" in context.params:
        load(context.params["scenario"], context.params["settings"])


def test_the_two_commands_come_first_and_are_there() -> None:
    assert TOOLS[:2] == ["./tools/run", "./tools/test"]
    for tool in TOOLS:
        assert (ROOT / tool).stat().st_mode & 0o111


def test_the_scenario_loads() -> None:
    (text,) = blocks("toml")
    values = tomllib.loads(text)
    scenario = resolve(draft("my-car", values))
    assert (scenario.plant.speed_mps, scenario.fault.for_s) == (25.0, 2.0)


def test_the_firmware_example_runs() -> None:
    (code,) = (block for block in blocks("python") if "firmware_model" in block)
    names: dict[str, object] = {}
    exec(code, names)
    assert names["answer"].mode == Mode.RUN  # type: ignore[attr-defined]


def test_the_log_example_runs(tmp_path: Path) -> None:
    log, _, _ = record(tmp_path, "duration_s=0.02", bus="virtual:readme")
    (code,) = (block for block in blocks("python") if "decode_log" in block)
    code = code.replace("runs/demo/bus.log", str(log)).replace("dbc/", f"{ROOT}/dbc/")
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["table"]["DStar"].tolist() == decoded(log)["DSTAR_FEEDBACK"].tolist()


def test_every_command_is_listed_and_every_listed_command_is_there() -> None:
    listed = set(re.findall(r"`can-rig ([a-z]+)", README))
    assert listed == set(COMMANDS)


def test_every_file_that_it_names_is_there() -> None:
    for path in re.findall(r"\]\(([^)]+)\)|`(dbc/[^`]+)`|`(can_rig/[a-z_/]+\.py)`", README):
        assert (ROOT / next(filter(None, path))).exists()
    for name in (LOG, SIGNALS, SUMMARY, REPORT):
        assert f"`{name}`" in README


@pytest.mark.parametrize("package", ["firmware_model", "can_rig"])
def test_every_module_has_its_place_in_the_structure(package: str) -> None:
    structure = README[README.index("## Structure") : README.index("## What to expect")]
    table = structure[structure.index(f"| `{package}/` |") :].split("\n\n")[0]
    named: dict[str, set[str]] = {}
    for row in table.splitlines()[2:]:
        folder, names = re.findall(r"^\| (?:`(\w+)/`: )?(.*?) \|", row)[0]
        named.setdefault(folder, set()).update(re.findall(r"`(\w+)`", names))
    there: dict[str, set[str]] = {}
    for path in (ROOT / package).rglob("*.py"):
        if not path.stem.startswith("__"):
            folder = str(path.parent.relative_to(ROOT / package))
            there.setdefault("" if folder == "." else folder, set()).add(path.stem)
    assert named == there
