"""The output of ``--report``: each tool finds planted errors, and none in exported files.

Costs on emulated boards are compared with something known.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from can_rig.assessment.resolve import load
from can_rig.cli.main import main
from can_rig.export.application import application, exported
from can_rig.export.boards import COMPILER, EMULATOR
from can_rig.export.costs import Cost, cost, instructions, sizes
from can_rig.export.findings import DEVIATIONS, Coverage, alarms, coverage, findings, misra
from can_rig.plant.frameless import controller_inputs
from firmware_model.law.layout import state_type, table_type
from firmware_model.law.schedule import Constants, State
from firmware_model.law.structs import record_type
from tests.rig.export.shared import EMULATED

SCENARIO = load("default", ["duration_s=0.05", 'design.precision="float32"'])
DRIVE = load(
    "drive-cycle",
    ["duration_s=0.1", "drive.ramps=[[0.04,8.0],[0.06,8.1]]", "design.speeds_mps=[8.0,8.9]",
     "fault.kind=none", 'design.precision="float32"'],
)  # fmt: skip
NOTHING = Coverage(0, 0, 0, 0, 0, 0, ())
FREE = Cost("m4f", "float32", 1111, 2222, 3333, 4444, np.array([5555.0]), np.array([6666.0]))


def few_files(*of: object) -> dict[str, str]:
    every = exported(SCENARIO).items()
    return {name: text for name, text in every if name.startswith(("crc", "e2e"))}


def needs(tool: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed")


# --- findings ------------------------------------------------------------------------------------


def test_findings_are_found() -> None:
    assert all(n in (0, "not installed") for n in findings(few_files()).values())
    wrong = {"wrong.c": "int f(void); int f(void) { int unused; return 0; }\n"}
    assert findings(wrong)["gcc"] != 0


@needs("cppcheck")
def test_misra_rules_that_are_broken_have_a_reason() -> None:
    """In files of several kinds: the report looks at all of them."""
    chosen = ("e2e.c", "frames.c", "constants.c", "biquad.c")
    files = exported(SCENARIO)
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
    """Also what blends."""
    found = coverage(DRIVE)
    assert found.different == 0
    assert found.compared == 100 * (2 * 12 + 1)  # after each change, each step and the start
    assert found.lines_run >= 0.98 * found.lines > 1000
    assert found.branches_taken >= 0.9 * found.branches > 300
    assert len(found.missed) == found.lines - found.lines_run
    assert not {"schedule.c", "ecu.c"} & {line.split(":")[0] for line in found.missed}


@pytest.mark.parametrize(
    "missing", [{EMULATOR: 1}, {COMPILER: 4, "gcov": 1}, {"cppcheck": 2}], ids=" ".join
)
def test_a_tool_that_is_not_installed_is_named(
    missing: dict[str, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rest is reported, whatever else this machine lacks."""
    there = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name: None if name in missing else there(name))
    monkeypatch.setattr("can_rig.cli.export.exported", few_files)
    monkeypatch.setattr("can_rig.export.findings.coverage", lambda scenario: NOTHING)
    monkeypatch.setattr("can_rig.export.costs.cost", lambda *of: FREE)
    command = ["export", "default", "--set", "duration_s=0.05", "--report", "--out"]
    done = CliRunner().invoke(main, [*command, str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    for tool, times in missing.items():
        named = [line for line in lines if "not installed" in line and tool in line]
        assert len(named) == times
    assert any(line.startswith("gcc: ") for line in lines)
    assert any("MISRA" in line for line in lines)
    assert any("random memory" in line for line in lines)
    compiled = there(COMPILER) is not None and COMPILER not in missing
    assert compiled == any("1111" in line for line in lines)
    counted = compiled and there(EMULATOR) is not None and EMULATOR not in missing
    assert counted == any("5555" in line for line in lines)


# --- costs ---------------------------------------------------------------------------------------


@EMULATED
def test_costs_are_of_the_law() -> None:
    found = cost(SCENARIO, "m4f", "float32", None)
    assert found.counts is None
    assert 4000 < found.code_bytes < 40_000
    assert 50 < found.stack_bytes < 4000
    assert found.constant_bytes == table_type("float32").itemsize
    assert found.state_bytes == state_type("float32").itemsize


@EMULATED
def test_costs_of_a_drive_are_of_its_designs_and_of_its_speed() -> None:
    """It keeps the table in memory, and a tick with another speed blends it."""
    assert controller_inputs(SCENARIO).shape == (50, 2)
    inputs = controller_inputs(DRIVE)
    speed = np.interp(np.arange(50) * 0.002, [0.04, 0.06], [8.0, 8.1])
    assert np.allclose(inputs[:, 2], speed, atol=1e-7)
    found = cost(DRIVE, "m4f", "float32", inputs)
    table, state = table_type("float32").itemsize, state_type("float32").itemsize
    assert found.constant_bytes == table + record_type(Constants, "float32").itemsize
    assert found.state_bytes == state + table + record_type(State, "float32").itemsize
    assert found.counts is not None
    assert 1000 < found.median <= found.worst
    changes = np.flatnonzero(np.diff(inputs[:, 2]))
    assert len(changes) == 10
    assert found.counts[changes + 1].min() > 10_000 + np.delete(found.counts, changes + 1).max()
    assert found.worst_tick in changes + 1


@EMULATED
def test_the_stack_is_that_of_the_deepest_way_through_either() -> None:
    files = application(DRIVE)
    of_law = {name: files[name] for name in files if name != "network.c"}
    large = "    volatile real large[{n}];\n    large[0] = share;\n    const int32_t n = "
    changed = of_law["schedule.c"].replace("    const int32_t n = ", large.format(n=2000))
    *_, deeper = sizes({**of_law, "schedule.c": changed}, "m4f")
    assert 8000 <= deeper < 8600


TURNS = '__asm__ volatile("mov r3, %0\\n1: subs r3, #1\\n bne 1b" ::"r"((int){n}) : "r3", "cc");'
COUNTED = """\
#include "firmware.h"
void firmware_init(struct {memory} *m) {{ (void)m; }}
void firmware_reset(struct {memory} *m, real r) {{ (void)m; (void)r; }}
void firmware_change_speed(struct {memory} *m, real v);
void firmware_change_speed(struct {memory} *m, real v) {{ {speed} (void)m; }}
struct firmware_answer firmware_step(struct {memory} *m, real r, real y)
{{ {step} (void)m; return (struct firmware_answer){{.command_1 = y}}; }}
"""


@EMULATED
@pytest.mark.parametrize("drives", [False, True])
def test_counts_are_exact_to_two_instructions(drives: bool) -> None:
    """A loop of two instructions takes 2 n for n turns, in a step and in a change of the speed."""
    scenario, memory = (DRIVE, "firmware_memory") if drives else (SCENARIO, "layout_state")
    files = {name: text for name, text in exported(scenario).items() if name.endswith(".h")}
    files |= {"schedule.c": ""} if drives else {}
    turns = {"speed": TURNS.format(n="v"), "step": TURNS.format(n="r")}
    files["firmware.c"] = COUNTED.format(memory=memory, **turns)
    steps, speeds = np.array([1.0, 101.0, 1.0, 1001.0]), np.array([1.0, 1.0, 3001.0, 501.0])
    inputs = [steps, steps, *([speeds] if drives else [])]
    counts = instructions(files, "m4f", np.column_stack(inputs))
    expected = 2.0 * (steps - 1.0 + (speeds - 1.0 if drives else 0.0))
    assert np.allclose(counts - counts[0], expected, atol=2.0)
    assert counts[0] < 400
