"""``requirements.lock``, which ``tools/setup`` installs, is within the bounds of pyproject.toml."""

import subprocess
import tomllib
from itertools import chain
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LOCK = (ROOT / "requirements.lock").read_text()
LOCKED = [Requirement(line) for line in LOCK.splitlines() if not line.startswith("#")]
DIRECT = [*PROJECT["dependencies"], *chain(*PROJECT["optional-dependencies"].values())]
OLDEST = int(PROJECT["requires-python"].removeprefix(">=3."))


def locked(name, minor):
    """The version of a package for a Python 3.``minor``, as it must be on the line: ``==...``."""
    environment = default_environment() | {
        "python_version": f"3.{minor}",
        "python_full_version": f"3.{minor}.0",
    }
    (specifier,) = {
        str(each.specifier)
        for each in LOCKED
        if each.name == name and (each.marker is None or each.marker.evaluate(environment))
    }
    return specifier


@pytest.mark.parametrize("minor", range(OLDEST, OLDEST + 4))
def test_every_dependency_has_one_version_within_its_bounds(minor):
    for requirement in map(Requirement, DIRECT):
        if requirement.name != PROJECT["name"]:  # not an extra that names others
            specifier = locked(requirement.name, minor)
            assert requirement.specifier.contains(specifier.removeprefix("==")), requirement


def test_upper_bounds_stay_open():
    for line in DIRECT:
        operators = {each.operator for each in SpecifierSet(str(Requirement(line).specifier))}
        assert operators <= {">="}, line


def test_it_names_versions_and_no_place_to_take_them_from():
    for each in LOCKED:
        assert each.url is None
        assert str(each.specifier).startswith("==")
    assert not [line for line in LOCK.splitlines() if line.startswith("-") or "://" in line]


def test_setup_installs_again_when_the_lock_changes(tmp_path):
    """With a Python that only notes what it is asked: constraints, and how often."""
    (tmp_path / "tools").mkdir()
    calls = tmp_path / "calls"
    for name in ("pyproject.toml", "requirements.lock", "tools/setup"):
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
        (tmp_path / name).chmod(0o755)
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\necho "$PIP_CONSTRAINT $*" >> {calls}\n')
    python.chmod(0o755)

    def installed(*arguments):
        calls.write_text("")
        subprocess.run([tmp_path / "tools/setup", *arguments], check=True, timeout=60)
        return calls.read_text().splitlines()

    (call,) = installed("test")
    assert call.startswith("requirements.lock -m pip install")
    assert call.endswith("--editable .[test]")
    assert installed("test") == installed() == []
    with (tmp_path / "requirements.lock").open("a") as lock:
        lock.write("another==1.0\n")
    assert len(installed("test")) == 1
    assert installed("test") == []
