"""Every tool ends well in its shortest form."""

import subprocess
import sys

import pytest

from tests.project.pages import ROOT

OWN_FRAMES = "--dbc=tests/rig/own_frames/motorola.dbc"
SHORTEST = {
    ("bench", "loop", "--rounds=1", "--seconds=0.1"),
    ("bench", "decode", "--rounds=1", "--frames=2000", OWN_FRAMES),
    ("bench", "filter", "--rounds=1", "--filters=1"),
    ("verdicts", "--scenarios=1"),
}
"""Tools with their arguments."""

ELSEWHERE = {
    "against_libraries": "tests/rig/logs/test_against_libraries.py",
    "flood": "tests/rig/nodes/test_flood.py", "fuzz": "tests/rig/fuzz/test_fuzz.py",
    "mutation": "tests/project/test_mutation.py", "release": "tests/project/test_release.py",
    "scenario_keys": "tests/project/test_scenario_keys.py", "setup": "tests/project/test_lock.py",
    "vcan_guest": "tests/project/test_vcan_guest.py", "website": "tests/project/test_website.py",
}  # fmt: skip
"""By tool, the tests that are about it."""

NOT_TESTED = {
    "lock": "asks the package index for every version",
    "record_drives": "would write to this checkout where a drive is no longer the same",
    "run": "its setup may install; can-rig run has tests of its own",
    "same_bytes": "compiles for every board and emulates each: more than 30 s",
    "test": "runs all of this",
}


def test_each_tool_is_run_here_or_there_or_has_a_reason():
    tools = {path.name for path in (ROOT / "tools").iterdir() if path.is_file() and not path.suffix}
    assert tools == {tool for tool, *_ in SHORTEST} | ELSEWHERE.keys() | NOT_TESTED.keys()
    assert all((ROOT / page).is_file() for page in ELSEWHERE.values())


@pytest.mark.parametrize("tool", ["lock", "scenario_keys", "setup", "test", "website"])
def test_a_script_asked_for_help_tells_its_use_and_does_nothing(tool):
    done = subprocess.run(
        [ROOT / "tools" / tool, "--help"], check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and not done.stderr
    head = (ROOT / "tools" / tool).read_text("utf-8").partition("\nset ")[0].splitlines()[1:]
    assert done.stdout.splitlines() == [line.removeprefix("# ") for line in head]


@pytest.mark.parametrize("words", sorted(SHORTEST))
def test_a_tool_ends_well(words):
    tool, *arguments = words
    command = [sys.executable, f"tools/{tool}.py", *arguments]
    done = subprocess.run(
        command, cwd=ROOT, check=False, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert "Traceback" not in done.stderr
