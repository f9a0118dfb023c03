"""``requirements.lock``, which ``tools/setup`` installs, is within the bounds of pyproject.toml."""

import os
import re
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
PACKAGES = {  # who needs it, by package
    Requirement(line.removesuffix(" \\")): set(words.split())
    for words, line in re.findall(r"^# (.*)\n(\S+==.*)$", LOCK, re.MULTILINE)
}
LOCKED = list(PACKAGES)
DIRECT = [*PROJECT["dependencies"], *chain(*PROJECT["optional-dependencies"].values())]
MINORS = [
    int(line.rpartition(".")[2])
    for line in PROJECT["classifiers"]
    if line.startswith("Programming Language :: Python :: 3.")
]


def environment(minor):
    return default_environment() | {
        "python_version": f"3.{minor}",
        "python_full_version": f"3.{minor}.0",
    }


def locked(name, minor):
    """The version of a package for a Python 3.``minor``, as it must be on the line: ``==...``."""
    (specifier,) = {
        str(each.specifier)
        for each in LOCKED
        if each.name == name and (each.marker is None or each.marker.evaluate(environment(minor)))
    }
    return specifier


@pytest.mark.parametrize("minor", MINORS)
def test_every_dependency_has_one_version_within_its_bounds(minor):
    for requirement in map(Requirement, DIRECT):
        if requirement.marker and not requirement.marker.evaluate(environment(minor)):
            continue
        if requirement.name != PROJECT["name"]:  # not an extra that names others
            specifier = locked(requirement.name, minor)
            assert requirement.specifier.contains(specifier.removeprefix("==")), requirement


def test_upper_bounds_stay_open():
    for line in {*DIRECT} - {*PROJECT["optional-dependencies"]["test"]}:  # of users alone
        operators = {each.operator for each in SpecifierSet(str(Requirement(line).specifier))}
        assert operators <= {">="}, line


def test_it_names_versions_and_hashes_and_no_place_to_take_them_from():
    assert len(LOCKED) == len(re.findall(r"^\w\S*", LOCK, re.MULTILINE))
    for each in LOCKED:
        assert each.url is None
        assert str(each.specifier).startswith("==")
    assert not [line for line in LOCK.splitlines() if line.startswith("-") or "://" in line]
    rest = [line for line in LOCK.splitlines() if line.startswith(" ")]
    assert all(re.fullmatch(r" {4}--hash=sha256:[0-9a-f]{64}( \\)?", line) for line in rest)


def test_it_says_which_extra_needs_a_package():
    words = {each.name: who for each, who in PACKAGES.items()}
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    for line in [*PROJECT["dependencies"], *build]:
        assert words[Requirement(line).name] == {"base"}
    for extra, lines in PROJECT["optional-dependencies"].items():
        for requirement in map(Requirement, lines):
            if requirement.name != PROJECT["name"]:
                assert words[requirement.name] & {extra, "base"}, requirement


PIP = """#!/bin/sh
case "$*" in
*" pip "*) echo "$*" >> {calls}; cp .venv/requirements {calls}.asked
    cat {calls}.says 2>/dev/null; exit $(cat {calls}.ends 2>/dev/null || echo 0) ;;
*venv*) mkdir -p .venv/bin; cp "$0" .venv/bin/python; echo made >> {calls} ;;
*version_info*) echo 11 ;;
--version) echo Python ;;
esac
"""


@pytest.fixture
def setup(tmp_path):
    """``tools/setup`` with a Python that notes its arguments and ends with a given status."""
    calls = tmp_path / "calls"
    for name in ("pyproject.toml", "requirements.lock", "tools/setup"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
        (tmp_path / name).chmod(0o755)
    python = tmp_path / "python"
    python.write_text(PIP.format(calls=calls))
    python.chmod(0o755)

    def run(*words, says="", ends=0):
        """Status, what was said, the calls."""
        calls.write_text("")
        Path(f"{calls}.says").write_text(says)
        Path(f"{calls}.ends").write_text(str(ends))
        done = subprocess.run(
            [tmp_path / "tools/setup", *words], env=os.environ | {"PYTHON": str(python)},
            check=False, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        return done.returncode, done.stderr, calls.read_text().splitlines()

    run.folder = tmp_path  # type: ignore[attr-defined]
    return run


def test_setup_installs_again_when_the_lock_or_an_extra_is_new(setup):
    status, _, (made, packages, project) = setup("fmu")
    assert (status, made) == (0, "made")
    assert "--require-hashes --requirement .venv/requirements" in packages
    assert "--no-build-isolation --editable ." in project
    asked = (setup.folder / "calls.asked").read_text()
    assert all(f"\n{name}==" in asked for name in ("numpy", "hatchling", "fmpy"))
    assert not any(f"\n{name}==" in asked for name in ("cma", "mypy"))
    assert setup()[2] == setup("fmu")[2] == []
    assert len(setup("search")[2]) == 2
    assert "\nfmpy==" in (setup.folder / "calls.asked").read_text()
    assert setup("fmu", "search")[2] == []
    assert len(setup("test")[2]) == 2
    assert setup("cluster")[2] == []
    with (setup.folder / "requirements.lock").open("a") as lock:
        lock.write("# test\nanother==1.0\n")
    assert len(setup()[2]) == 2
    assert setup("test")[2] == []


def test_setup_refuses_an_extra_that_is_none_by_name(setup):
    extras = " ".join(PROJECT["optional-dependencies"])
    line = f"error: no extra is called 'fmus'; there are: {extras}\n"
    assert setup("search", "fmus") == (2, line, [])


@pytest.mark.parametrize(
    ("says", "reason"),
    [
        ("WARNING: NewConnectionError\nERROR: No matching distribution", "the package index does"),
        ("ERROR: THESE PACKAGES DO NOT MATCH THE HASHES", "installed: ERROR: THESE PACKAGES DO"),
    ],
)
def test_setup_says_in_one_line_why_it_installs_nothing(setup, says, reason):
    status, said, _ = setup(says=says, ends=1)
    assert status == 2
    (line,) = [line for line in said.splitlines() if not line.endswith("...")]
    assert line.startswith("error: the packages could not be ")
    assert reason in line
    assert setup()[2][0].startswith("-m pip install")  # goes on in the same environment


def test_setup_makes_an_environment_anew_that_was_left_half_done_or_does_not_start(setup):
    assert setup(says="Installing collected packages: numpy", ends=1)[0] == 2
    status, said, (made, *_) = setup()
    assert (status, made) == (0, "made")
    assert said.startswith("making .venv anew: its last installation was interrupted\n")
    (setup.folder / ".venv/bin/python").unlink()
    (setup.folder / ".venv/bin/python").symlink_to("python-that-is-gone")
    status, said, (made, *_) = setup()
    assert (status, made) == (0, "made")
    assert said.startswith("making .venv anew: its Python does not start, or has no pip\n")
