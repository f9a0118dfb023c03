"""The house: rooms that one can take in at a glance, and imports that only go down."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]
PACKAGES = ("can_rig", "firmware_model")
ROOTS = {
    "can_rig": {"__init__", "__main__", "errors", "files", "folders", "paged"},
    "firmware_model": {"__init__", "compiled", "errors", "firmware"},
}
TOP_LEVEL = {
    *(
        ".ci",
        ".github",
        ".gitignore",
        ".pre-commit-config.yaml",
        "can_rig",
        "dbc",
        "docs",
        "firmware_model",
        "tests",
        "tools",
    ),
    *("CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "README.md", "pyproject.toml"),
    "requirements.lock",
}
HEAVY = {"matplotlib", "asammdf", "fmpy", "pyarrow", "pandas", "control", "mcap", "aiohttp"}
"""Libraries so slow to import that a command that does without them must not wait for them."""

COMMANDS = ("can_rig.cli.", "can_rig.__main__")
"""Modules that may import whatever they need when they need it."""


def sources(*folders: str) -> list[Path]:
    found = [path for folder in folders for path in sorted((CHECKOUT / folder).rglob("*.py"))]
    assert found
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_beside_the_rooms_lies_only_what_all_of_them_need(package: str) -> None:
    assert {path.stem for path in (CHECKOUT / package).glob("*.py")} == ROOTS[package]


def test_nothing_else_was_committed_at_the_top_level() -> None:
    if not (CHECKOUT / ".git").exists() or not shutil.which("git"):
        pytest.skip("no checkout of git, or no git, to tell what was committed")
    command = ["git", "-c", "safe.directory=*", "ls-files"]  # whoever owns the checkout
    listed = subprocess.run(
        command, cwd=CHECKOUT, capture_output=True, text=True, check=True
    ).stdout
    assert {Path(line).parts[0] for line in listed.splitlines()} == TOP_LEVEL


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


def test_only_commands_and_heavy_libraries_excuse_an_import_within_a_function() -> None:
    """It may keep a heavy library out of a light command; it may not hide a circle."""
    unexcused = {
        name_of(path): late
        for path in sources(*PACKAGES)
        if not name_of(path).startswith(COMMANDS)
        and (late := [name for name in imports_within_functions(path) if not is_heavy(name)])
    }
    assert unexcused == {}


# Broken arrows, and what the contracts say of each.
BROKEN = (
    ("can_rig/frames/codec.py", "from can_rig.nodes import lockstep", "codec -> can_rig.nodes"),
    (
        "can_rig/scenario/reference.py",
        "def late():\n    from can_rig.plant import faults",
        "reference -> can_rig.plant",
    ),
    ("can_rig/logs/frames.py", "from can_rig.frames import codec", "frames -> can_rig.frames"),
    (
        "firmware_model/law/filters/biquad.py",
        "from firmware_model.design import zpk",
        "biquad -> firmware_model.design.zpk",
    ),
    ("firmware_model/design/zpk.py", "import can_rig.errors", "zpk -> can_rig.errors"),
    ("firmware_model/firmware.py", "import can", "firmware_model.firmware -> can "),
    ("firmware_model/compiled.py", "import time", "firmware_model.compiled -> time "),
    (
        "can_rig/frames/codec.py",
        "from can_rig.frames import network",
        "cycles are allowed in can_rig.frames.",
    ),
    ("can_rig/attic/__init__.py", "from can_rig import errors", "- can_rig.attic "),
)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Both packages without their data, to be broken."""
    folder = tmp_path / "copy"
    for path in [*sources(*PACKAGES), CHECKOUT / "pyproject.toml"]:
        target = folder / path.relative_to(CHECKOUT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target)
    return folder


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-logo"]
    return subprocess.run(  # PYTHONPATH would put the checkout before the copy
        command,
        cwd=folder,
        env={"COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_the_contracts_are_kept(copy: Path) -> None:
    done = lint(copy)
    assert done.returncode == 0, done.stdout


def test_the_contracts_object(copy: Path) -> None:
    for name, statement, _ in BROKEN:
        path = copy / name
        path.parent.mkdir(exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(f"\n{statement}\n")
    done = lint(copy)
    assert done.returncode == 1
    objections = " ".join(done.stdout.split())
    assert [said for *_, said in BROKEN if said not in objections] == []
