"""What ``--report`` says of exported files: each tool finds what is wrong, and nothing here."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from can_rig.assessment.resolve import load
from can_rig.cli.main import main
from can_rig.export.application import exported
from can_rig.export.costs import Cost
from can_rig.export.ecus import COMPILER, EMULATOR
from can_rig.export.findings import DEVIATIONS, Coverage, alarms, coverage, findings, misra

SCENARIO = load("default", ['design.precision="float32"'])
DRIVE = load("drive-cycle", ["design.speeds_mps=[8.0,8.9]"])
NOTHING = Coverage(0, 0, 0, 0, 0, 0, ())
FREE = Cost("m4f", "float32", 1111, 2222, 3333, 4444, np.array([5555.0]))


def few_files(*of: object) -> dict[str, str]:
    return {name: text for name, text in exported(SCENARIO).items() if name.startswith("e2e")}


def needs(tool: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed")


def test_findings_are_found() -> None:
    files = exported(SCENARIO)
    found = findings({name: text for name, text in files.items() if name.startswith("e2e")})
    assert all(n in (0, "not installed") for n in found.values())
    wrong = {"wrong.c": "int f(void); int f(void) { int unused; return 0; }\n"}
    assert findings(wrong)["gcc"] != 0


@needs("cppcheck")
def test_misra_rules_that_are_broken_have_a_reason() -> None:
    """In files of every kind: the report looks at all of them."""
    chosen = ("e2e.c", "frames.c", "constants.c", "biquad.c", "decision.c", "schedule.c")
    files = exported(DRIVE)
    found = misra({n: text for n, text in files.items() if n.endswith(".h") or n in chosen})
    assert found is not None
    of_the_whole = {"2.5", "8.7"}  # what other files use
    assert {"9.3", "10.4", "12.1"} <= set(found) - of_the_whole <= set(DEVIATIONS)
    wrong = {"wrong.c": "int f(int x) { return x; }\n"}  # without a prototype
    assert misra(wrong) == {"8.4": 1}


@needs("frama-c")
def test_eva_finds_what_may_go_wrong() -> None:
    start = "int main(int c, char **v) { int a[3] = {1, 2, 3}; (void)v; "
    assert alarms({"right.c": start + "return a[(unsigned)c % 3]; }\n"}) == []
    found = alarms({"wrong.c": start + "return a[c] / (c - 1); }\n"})
    assert {line.split(":")[0] for line in found} == {"wrong.c"}
    assert len(found) >= 2


@needs("gcov")
def test_the_trials_run_nearly_all_of_it() -> None:
    found = coverage(SCENARIO)
    assert found.different == 0 < found.compared
    assert found.lines_run >= 0.98 * found.lines > 1000
    assert found.branches_taken >= 0.9 * found.branches > 300
    assert len(found.missed) == found.lines - found.lines_run


@needs("gcov")
def test_those_of_a_drive_run_what_blends() -> None:
    found = coverage(DRIVE)
    assert found.different == 0
    assert found.compared == 100 * (2 * 12 + 1)  # after each change, each step and the start
    assert not [place for place in found.missed if place.startswith("schedule.c")]
    assert "firmware.c" not in {place.split(":")[0] for place in found.missed}
    assert not [place for place in found.missed if place.startswith("ecu.c")]


@pytest.mark.parametrize("tool", [COMPILER, EMULATOR, "gcov", "cppcheck"])
def test_a_tool_that_is_not_installed_is_named(
    tool: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rest is reported, whatever else this machine lacks."""
    there = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name: None if name == tool else there(name))
    monkeypatch.setattr("can_rig.cli.design.export.exported", few_files)
    monkeypatch.setattr("can_rig.export.findings.coverage", lambda scenario: NOTHING)
    monkeypatch.setattr("can_rig.export.costs.cost", lambda *of: FREE)
    command = ["export", "default", "--set", "duration_s=0.05", "--report", "--out"]
    done = CliRunner().invoke(main, [*command, str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    named = [line for line in lines if "not installed" in line and tool in line]
    assert len(named) == {COMPILER: 4, EMULATOR: 1, "gcov": 1, "cppcheck": 2}[tool]
    assert any(line.startswith("gcc: ") for line in lines)
    assert any("MISRA" in line for line in lines)
    assert any("random memory" in line for line in lines)
    assert (there(COMPILER) is None or tool == COMPILER) == all(
        "1111" not in line for line in lines
    )
    counted = there(COMPILER) and there(EMULATOR) and tool not in (COMPILER, EMULATOR)
    assert bool(counted) == any("5555" in line for line in lines)
