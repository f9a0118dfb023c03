"""The start and the reset of an exported controller, whatever its memory held before."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from can_rig.assessment.resolve import load
from can_rig.export.application import exported
from can_rig.scenario.build import network_of
from can_rig.scenario.driving import controls
from firmware_model.firmware import Firmware
from tests.rig.export.test_folder import NOT_FIRMWARE, run

STARTED = """\
#include <stdio.h>
#include <string.h>

#include "firmware.h"

static struct {memory} memory;

int main(int argc, char **argv)
{
    double reference;
    double measurement;

    memset(&memory, 85, sizeof memory);
    firmware_init(&memory);
    if (argc > 1) {
        firmware_reset(&memory, (real)(argv[1][0] - '0'));
    }
    while (scanf("%lf %lf", &reference, &measurement) == 2) {
        const struct firmware_answer answer =
            firmware_step(&memory, (real)reference, (real)measurement);
        printf("%.17g %.17g %.17g %d\\n", (double)answer.command_1, (double)answer.command_2,
               (double)answer.fault_estimate, (int)answer.mode);
    }
    return 0;
}
"""


@pytest.mark.parametrize("name", ["default", "drive-cycle"])
def test_a_start_leaves_nothing_of_the_memory_and_a_reset_settles(
    name: str, tmp_path: Path
) -> None:
    """Memory that is not zero, as after a warm start; a reset to 1 m/s²."""
    speeds = ["design.speeds_mps=[8.0, 8.9, 10.0]"] if name == "drive-cycle" else []
    scenario = load(name, ['design.precision="float32"', *speeds])
    files = exported(scenario)
    memory = "firmware_memory" if speeds else "layout_state"
    files["started.c"] = STARTED.replace("{memory}", memory)
    for each, text in files.items():
        (tmp_path / each).write_text(text, encoding="utf-8")
    others = {*NOT_FIRMWARE, "ecu.c"}
    units = [each for each in files if each.endswith(".c") and each not in others]
    run("cc", "-std=c99", "-O1", "-ffp-contract=off", *units, "-lm", "-o", "started", cwd=tmp_path)
    inputs = [(math.sin(k / 30) + 1.0, math.sin(k / 30 - 0.4) + 1.0) for k in range(100)]
    text = "".join(f"{r!r} {y!r}\n" for r, y in inputs)
    of = controls(scenario, network_of(scenario))
    for arguments in ([], ["1"]):
        firmware = Firmware(of.table, speeds=of.schedule)
        if arguments:
            firmware.reset(1.0)
        answers = run(tmp_path / "started", *arguments, input=text).splitlines()
        for line, values in zip(answers, inputs, strict=True):
            assert tuple(map(float, line.split())) == tuple(map(float, firmware.step(*values)))[:4]
