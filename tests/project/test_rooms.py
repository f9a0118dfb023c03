"""The house: rooms that one can take in at a glance, and imports that only go down."""

import ast
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

from tests.project.pages import table, text_of

CHECKOUT = Path(__file__).parents[2]
PACKAGES = ("can_rig", "firmware_model")
ROOTS = {
    "can_rig": {"__init__", "__main__", "errors"},
    "firmware_model": {"__init__", "compiled", "errors", "firmware"},
}
TOP_LEVEL = {
    *(".ci", ".github", ".gitignore", ".pre-commit-config.yaml", "can_rig", "dbc", "docs",
      "firmware_model", "tests", "tools"),
    *("CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "README.md", "pyproject.toml"),
    "requirements.lock",
}  # fmt: skip
TRANSLATOR = "can_rig.export."  # to C: a tenth of a second of each start
HEAVY = {"matplotlib", "asammdf", "fmpy", "pyarrow", "pandas", "control", "mcap", "aiohttp"}
"""Libraries so slow to import that a command that does without them must not wait for them."""

COMMANDS = ("can_rig.cli.", "can_rig.__main__")
"""Modules that may import whatever they need when they need it."""


def sources(*folders: str) -> list[Path]:
    found = [path for folder in folders for path in sorted((CHECKOUT / folder).rglob("*.py"))]
    assert found
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_beside_the_rooms_lies_only_what_all_of_them_need(package):
    assert {path.stem for path in (CHECKOUT / package).glob("*.py")} == ROOTS[package]


def test_nothing_else_was_committed_at_the_top_level():
    if not (CHECKOUT / ".git").exists() or not shutil.which("git"):
        pytest.skip("no checkout of git, or no git, to tell what was committed")
    command = ["git", "-c", "safe.directory=*", "ls-files"]  # whoever owns the checkout
    listed = subprocess.run(
        command, cwd=CHECKOUT, capture_output=True, text=True, check=True
    ).stdout
    assert {Path(line).parts[0] for line in listed.splitlines()} == TOP_LEVEL


@pytest.mark.parametrize("package", PACKAGES)
def test_the_architecture_page_has_every_room_and_no_other(package):
    root = CHECKOUT / package
    rooms = {path.parent for path in root.rglob("__init__.py")} - {root}
    rows = table(text_of("docs/architecture.md"), f"`{package}/`")
    listed = [name for cell, *_ in rows for name in re.findall(r"`([\w/]+)/`", cell)]
    assert sorted(listed) == sorted(str(room.relative_to(root)) for room in rooms)


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(CHECKOUT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in sources(*PACKAGES)}


def imported(node: ast.stmt) -> list[str]:
    """Modules that one statement imports; ``from room import module`` counts as the module."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.module and not node.level:
        inside = [f"{node.module}.{alias.name}" for alias in node.names]
        return [name for name in inside if name in MODULES] or [node.module]
    return []


@cache
def is_heavy(module: str) -> bool:
    """Whether importing ``module`` imports a heavy library, itself or through another of ours."""
    if module.startswith(TRANSLATOR):
        return True
    if module not in MODULES:
        return module.split(".", maxsplit=1)[0] in HEAVY
    body = ast.parse(MODULES[module].read_text("utf-8")).body
    return any(is_heavy(name) for node in body for name in imported(node))


def imports_within_functions(path: Path) -> list[str]:
    tree = ast.parse(path.read_text("utf-8"))
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    inside = {node for function in functions for node in ast.walk(function)}
    names = [name for node in inside if isinstance(node, ast.stmt) for name in imported(node)]
    return sorted(name for name in names if name.split(".")[0] in PACKAGES)


def test_only_commands_and_heavy_libraries_excuse_an_import_within_a_function():
    """It may keep a heavy library out of a light command; it may not hide a circle."""
    unexcused = {
        name_of(path): late
        for path in sources(*PACKAGES)
        if not name_of(path).startswith(COMMANDS)
        and (late := [name for name in imports_within_functions(path) if not is_heavy(name)])
    }
    assert unexcused == {}


ENTRIES = {
    *("controller.start_up", "controller.step", "controller.reset", "schedule.change_speed"),
    *("supervision.further_sensors.hear", "supervision.lost_commands.act"),
    "supervision.knowledge.saved_in",
}
"""The functions of the law that others call, with the whole memory of a controller."""


def memories_taken(path: Path) -> set[str]:
    """The functions of a module with a parameter of the type ``layout.State``."""
    text = path.read_text("utf-8")
    said = {"layout.State"}
    if re.search(r"law\.layout import [^\n]*\bState\b", text):
        said.add("State")
    room = name_of(path).removeprefix("firmware_model.law.")
    return {
        f"{room}.{node.name}"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
        and said & {ast.unparse(each.annotation) for each in node.args.args if each.annotation}
    }


def test_only_the_entries_of_the_law_take_its_whole_memory():
    """A stage gets its inputs: the memory of the thesis's law, of the supervision, or less."""
    assert set().union(*map(memories_taken, sources("firmware_model/law"))) == ENTRIES
