"""What --report says of costs on emulated boards, against something known."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.export.evidence.costs import cost, inputs_of_run, instructions
from can_rig.export.folder import exported
from can_rig.export.law import law_files
from can_rig.export.running.emulated_ecu import COMPILER, EMULATOR

pytestmark = pytest.mark.skipif(
    shutil.which(COMPILER) is None or shutil.which(EMULATOR) is None,
    reason=f"{COMPILER} or {EMULATOR} is not installed",
)
SCENARIO = load("default", ["duration_s=0.05", 'design.precision="float32"'])


def test_costs_are_of_the_law() -> None:
    inputs = inputs_of_run(SCENARIO)
    assert inputs.shape == (50, 2)
    found = cost(SCENARIO, "m4f", "float32", inputs)
    assert 1000 < found.median <= found.worst < 50_000
    assert 0 <= found.worst_tick < 50
    assert 4000 < found.code_bytes < 40_000
    assert 50 < found.stack_bytes < 4000


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
