"""Without the packages of an extra, a line names the extra before any work."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[3]

WITHOUT = """
import importlib.metadata, json, sys
missing = json.loads(sys.argv[1])
sys.modules.update(dict.fromkeys(missing))
version = importlib.metadata.version
def version_of_what_is_there(name):
    if name in missing:
        raise importlib.metadata.PackageNotFoundError(name)
    return version(name)
importlib.metadata.version = version_of_what_is_there
from can_rig.__main__ import main
status = 0
for words in json.loads(sys.argv[2]):
    sys.argv = ["can-rig", *words]
    try:
        main()
    except SystemExit as end:
        status = end.code or 0
        print("ended with", status)
sys.exit(status)
"""
OF_EXTRAS = ["cma", "distributed", "fmpy", "serial", "pytest", "ipykernel"]
FMU = [
    *("--set", "plant.kind=fmu:a.fmu", "--set", "plant.variables.input_1=u"),
    *("--set", "plant.variables.input_2=v", "--set", "plant.variables.output=y"),
]
SHORT = ["thesis-step", "--in-process", "--set", "duration_s=0.01"]


def rig_without(packages: list[str], *commands: list[str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, json.dumps(packages), json.dumps(commands)]
    here = os.environ | {"PYTHONPATH": str(ROOT)}  # also in a copy of the checkout
    return subprocess.run(
        command, capture_output=True, text=True, timeout=300, check=False, env=here
    )


@pytest.mark.parametrize(
    ("extra", "package", "words"),
    [
        ("fmu", "fmpy", ["run", *SHORT, *FMU]),
        ("search", "cma", ["campaign", "losses", "--search", "all"]),
        ("cluster", "distributed", ["campaign", "losses", "--scheduler", "tcp://127.0.0.1:1"]),
    ],
)
def test_one_line_says_how_to_install_the_extra(extra, package, words):
    done = rig_without([package], words)
    assert done.returncode == 2
    said = re.fullmatch(rf"error: {package} is not installed: (\S+)(.*)\n", done.stderr)
    assert said, done.stderr
    if said[1] == sys.executable:  # an environment that tools/setup has not made
        install, needed = re.fullmatch(r" -m pip (install) '(.*)'", said[2]).groups()
        assert (install, Requirement(needed).name) == ("install", package)
    else:
        assert Path(said[1]).samefile(ROOT / "tools" / "setup")
        assert said[2].strip() == extra


def test_what_the_readme_lists_needs_no_extra(tmp_path):
    (tmp_path / "a.log").write_text("(0.000000) can0 101#0011223344556677\n")
    done = rig_without(
        OF_EXTRAS,
        ["run", *SHORT, "--out", "r", "--log", "x.mf4"],
        ["decode", "r", "--out", "x.mcap"],
        ["figures", "thesis-step", "--set", "duration_s=0.01"],
        ["panel", "--port", "0", "--set", "duration_s=-1"],
    )
    assert "not installed" not in done.stderr
    assert re.findall(r"ended with (\d)", done.stdout) == ["0", "0", "0", "2"], done.stderr
    versions = json.loads((tmp_path / "r" / "run.json").read_text("utf-8"))["versions"]
    assert {"numpy", "python-can", "fault-tolerant-steering"} <= set(versions)
    assert not versions.keys() & set(OF_EXTRAS)
