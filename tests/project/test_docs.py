"""What the documentation says can be followed, typed or run, can be."""

import inspect
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import pytest

from can_rig.campaigns.plan import plan
from can_rig.campaigns.settings import read_campaign
from can_rig.cli.main import main
from can_rig.plant.protocol import PlantProtocol, load_plant
from can_rig.results.execution import refuse
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load
from can_rig.scenario.plant_settings import PlantSettings
from tests.project.pages import PAGES, ROOT, TUTORIALS, blocks, command_lines, prose, text_of

COMMANDS = main.list_commands(click.Context(main))
LINES = [(page.name, line) for page in PAGES for line in command_lines(page.read_text("utf-8"))]
RIG = [line for name, line in LINES if line.startswith("can-rig ") and name not in TUTORIALS]
OTHERS = {"cantools", "cc", "git", "nice", "pytest", "python", "sudo"}  # programs that are not ours
PLACES = "can_rig|dbc|docs|firmware_model|tests|tools"


def ids(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_file_that_it_names_is_there(page):
    for name in re.findall(rf"`((?:{PLACES})/[\w./-]*)", prose(page.read_text("utf-8"))):
        assert (ROOT / name).exists(), name


def test_the_index_has_every_page():
    index = text_of("docs/README.md")
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "README.md" or f"]({page.name})" in index


@pytest.fixture
def own_controllers(tmp_path, monkeypatch):
    """Goes to a folder with the controllers of the page on controllers."""

    def go() -> None:
        (code,) = blocks(text_of("docs/controllers.md"), "python")
        (tmp_path / "mypi.py").write_text(code, "utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        include = ROOT / "can_rig" / "controllers"
        flags = ["-shared", "-fPIC", "-O2", f"-I{include}", "-o", "pi.so"]
        subprocess.run(["cc", *flags, ROOT / "docs" / "examples" / "pi.c"], check=True)

    return go


@pytest.mark.parametrize("line", RIG)
def test_a_command_parses_and_its_scenario_loads(line, own_controllers):
    if "mypi" in line or "pi.so" in line:
        own_controllers()
    _, name, *arguments = shlex.split(line)
    command = main.get_command(click.Context(main), name)
    assert command is not None
    context = command.make_context(name, list(arguments))
    if name == "campaign":
        keys = {key: context.params[key] for key in ("runs", "seed")}
        keys["scenario"] = list(context.params["scenarios"]) or None
        plan(read_campaign(context.params["campaign"], context.params["settings"], **keys))
    elif "scenario" in context.params:
        scenario = load(context.params["scenario"], context.params["settings"])
        if name == "run":
            refuse(scenario, context.params["allow_unstable"])


@pytest.mark.parametrize(("page", "line"), LINES)
def test_every_other_line_calls_a_tool_that_is_there(page, line):
    program = line.split(maxsplit=1)[0]
    if program.startswith("./tools/"):
        assert (ROOT / program).stat().st_mode & 0o111
    elif not program.startswith(".venv/bin/"):
        assert program in {"can-rig", *OTHERS}, f"{page}: {line}"


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_command_that_the_text_mentions_is_there(page):
    assert set(re.findall(r"`can-rig ([a-z]+)", page.read_text("utf-8"))) <= set(COMMANDS)


CHASSIS = ROOT / "tests" / "rig" / "own_frames" / "motorola.dbc"


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_scenario_loads(page, tmp_path):
    for block in blocks(page.read_text("utf-8"), "toml"):
        tomllib.loads(block)
        file = tmp_path / "my-car.toml"
        file.write_text(block, "utf-8")
        (tmp_path / "chassis.dbc").write_bytes(CHASSIS.read_bytes())  # that of the page on buses
        if "[axes]" in block or "[choices" in block:  # a campaign
            scenario = plan(read_campaign(str(file))).scenario_of(1)
        else:
            scenario = load(str(file))
        controller_table(scenario, network_of(scenario))


RUN = (
    *("docs/design.md", "docs/firmware.md"),
    *("docs/c-export.md", "docs/python.md", "docs/unit-test-a-filter.md"),
)


@pytest.mark.parametrize("page", RUN)
def test_its_python_runs(page, tmp_path, capsys):
    code = "\n".join(blocks(text_of(page), "python"))
    assert code
    (tmp_path / "page.py").write_text(code, "utf-8")
    names = runpy.run_path(str(tmp_path / "page.py"), run_name="page_of_the_docs")
    for name, test in names.items():
        if name.startswith("test_") and callable(test):
            test(*[tmp_path] * len(inspect.signature(test).parameters))


def test_the_test_of_a_filter_is_short_and_runs_by_pytest_alone(tmp_path):
    code = blocks(text_of("docs/unit-test-a-filter.md"), "python")[0]
    assert len(code.splitlines()) <= 6
    (tmp_path / "test_of_the_docs.py").write_text(code, "utf-8")
    bare = [
        word
        for name in ("cacheprovider", "timeout", "xdist", "cov")
        for word in ("-p", f"no:{name}")
    ]
    of_the_checkout = ("-c", str(ROOT / "pyproject.toml"), str(tmp_path))
    command = [sys.executable, "-m", "pytest", "-q", *bare, *of_the_checkout]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert "1 passed" in done.stdout, done.stdout


def test_every_python_block_is_run_by_some_test():
    with_python = {ids(page) for page in PAGES if blocks(page.read_text("utf-8"), "python")}
    assert with_python == {
        *RUN,  # above
        # below, in test_docs_logs, and above
        *("docs/logs.md", "docs/scenarios.md", "docs/controllers.md"),
        "docs/tutorial-own-filter.md",  # in test_docs_logs
        "docs/recorded-drives.md",  # in test_recorded_drive
    }


def test_the_plant_of_ones_own_is_one(tmp_path, monkeypatch):
    (code,) = blocks(text_of("docs/scenarios.md"), "python")
    (tmp_path / "mycar_of_the_docs.py").write_text(code, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    kind = "mycar_of_the_docs:Lag"
    plant = load_plant(kind, PlantSettings(kind=kind))
    assert isinstance(plant, PlantProtocol)
    for _ in range(2000):
        settled = plant.advance(0.001, 50.0, 0.0)
    assert settled == pytest.approx(1.0)  # 0.02 m/s² per N m, after twenty time constants


def test_nothing_in_the_repository_cites_a_page_that_is_not_there():
    pages = {page.name for page in PAGES} | {"commands.md", "index.md"}  # made by tools/website
    text = text_of("docs/traps.md")
    traps = re.findall(r"^(\d+)\. \*\*", text, re.MULTILINE)
    assert traps == re.findall(r"\b(\d+)\. \*\*", text)  # none within the one before
    assert traps == [str(number) for number in range(1, len(traps) + 1)]
    for folder in PLACES.split("|"):
        for file in (ROOT / folder).rglob("*"):
            if file.suffix not in {".py", ".toml", ".dbc", ".c", ""} or not file.is_file():
                continue
            text = file.read_text("utf-8")
            cited = set(re.findall(r"\b[\w-]+\.md\b", text))
            assert cited <= pages, f"{file}: {cited - pages}"
            cited = set(re.findall(r"\b[Tt]rap (\d+)", text))  # of docs/traps.md
            assert cited <= set(traps), f"{file}: trap {cited - set(traps)}"
