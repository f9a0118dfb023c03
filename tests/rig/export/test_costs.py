"""What --report says of costs on emulated boards, against something known."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.export.application import application, exported
from can_rig.export.costs import cost, inputs_of_run, instructions, sizes
from can_rig.export.ecus import COMPILER, EMULATOR
from can_rig.export.law import law_files
from firmware_model.target.layout import state_type, table_type
from firmware_model.target.schedule import CONSTANTS, STATE
from firmware_model.target.structs import record_type

pytestmark = pytest.mark.skipif(
    shutil.which(COMPILER) is None or shutil.which(EMULATOR) is None,
    reason=f"{COMPILER} or {EMULATOR} is not installed",
)
SCENARIO = load("default", ["duration_s=0.05", 'design.precision="float32"'])

DRIVE = load(
    "drive-cycle",
    ["duration_s=0.1", "drive.ramps=[[0.04,8.0],[0.06,8.1]]", "design.speeds_mps=[8.0,8.9]",
     "fault.kind=none", 'design.precision="float32"'],
)  # fmt: skip


def test_costs_are_of_the_law() -> None:
    inputs = inputs_of_run(SCENARIO)
    assert inputs.shape == (50, 2)
    found = cost(SCENARIO, "m4f", "float32", inputs)
    assert 1000 < found.median <= found.worst < 50_000
    assert 0 <= found.worst_tick < 50
    assert 4000 < found.code_bytes < 40_000
    assert 50 < found.stack_bytes < 4000
    assert found.constant_bytes == table_type("float32").itemsize
    assert found.state_bytes == state_type("float32").itemsize


def test_costs_of_a_drive_are_of_its_designs_and_of_its_speed() -> None:
    """It keeps the table in memory, and a tick with another speed blends it."""
    inputs = inputs_of_run(DRIVE)
    speed = np.interp(np.arange(50) * 0.002, [0.04, 0.06], [8.0, 8.1])
    assert np.allclose(inputs[:, 2], speed, atol=1e-7)
    found = cost(DRIVE, "m4f", "float32", inputs)
    table, state = table_type("float32").itemsize, state_type("float32").itemsize
    assert found.constant_bytes == table + record_type(CONSTANTS, "float32").itemsize
    assert found.state_bytes == state + table + record_type(STATE, "float32").itemsize
    assert found.counts is not None
    changes = np.flatnonzero(np.diff(inputs[:, 2]))
    assert len(changes) == 10
    assert found.counts[changes + 1].min() > 10_000 + np.delete(found.counts, changes + 1).max()
    assert found.worst_tick in changes + 1


def test_the_stack_is_that_of_the_deepest_way_through_either() -> None:
    files = application(DRIVE)
    of_law = {name: files[name] for name in files if name != "network.c"}
    large = "    volatile real large[{n}];\n    large[0] = share;\n    const int32_t n = "
    changed = of_law["schedule.c"].replace("    const int32_t n = ", large.format(n=2000))
    *_, deeper = sizes({**of_law, "schedule.c": changed}, "m4f")
    assert 8000 <= deeper < 8600


def test_counts_are_exact_to_two_instructions() -> None:
    """A step that only turns a loop of two instructions n times takes 2 n more than one of none."""
    loop = '__asm__ volatile("mov r3, %0\\n1: subs r3, #1\\n bne 1b" ::"r"(n) : "r3", "cc");'
    headers = law_files("float32").items()
    files = {name: text for name, text in headers if name.endswith(".h")}
    files["firmware.h"] = exported(SCENARIO)["firmware.h"]
    files["firmware.c"] = (
        '#include "firmware.h"\n'
        "void firmware_init(struct layout_state *state) { (void)state; }\n"
        "void firmware_reset(struct layout_state *state, real r) { (void)state; (void)r; }\n"
        "struct firmware_answer firmware_step(struct layout_state *s, real r, real y)\n"
        f"{{ int n = (int)r; {loop} (void)s;\n"
        "  return (struct firmware_answer){.command_1 = y}; }\n"
    )
    turns = np.array([1.0, 101.0, 1001.0, 5001.0])
    counts = instructions(files, "m4f", np.column_stack([turns, turns]))
    assert np.allclose(counts - counts[0], 2.0 * (turns - 1.0), atol=2.0)
    assert counts[0] < 200


def test_the_change_of_the_speed_is_counted_with_the_step() -> None:
    """Each turns as often as its input says: the count is of both."""
    loop = '__asm__ volatile("mov r3, %0\\n1: subs r3, #1\\n bne 1b" ::"r"(n) : "r3", "cc");'
    files = {name: text for name, text in exported(DRIVE).items() if name.endswith(".h")}
    files["schedule.c"] = ""
    files["firmware.c"] = (
        '#include "firmware.h"\n'
        "void firmware_init(struct firmware_memory *m) { (void)m; }\n"
        "void firmware_reset(struct firmware_memory *m, real r) { (void)m; (void)r; }\n"
        f"void firmware_change_speed(struct firmware_memory *m, real v)\n"
        f"{{ int n = (int)v; {loop} (void)m; }}\n"
        "struct firmware_answer firmware_step(struct firmware_memory *m, real r, real y)\n"
        f"{{ int n = (int)r; {loop} (void)m;\n"
        "  return (struct firmware_answer){.command_1 = y}; }\n"
    )
    steps, speeds = np.array([1.0, 101.0, 1.0, 1001.0]), np.array([1.0, 1.0, 3001.0, 501.0])
    counts = instructions(files, "m4f", np.column_stack([steps, steps, speeds]))
    assert np.allclose(counts - counts[0], 2.0 * (steps - 1.0 + speeds - 1.0), atol=2.0)
