"""The exported folder: its content, its build without a warning, and its answers."""

import math
import re
import shutil
import subprocess

import numpy as np
import pytest

from can_rig.export.application import HEADER, exported, write
from can_rig.export.c_files import WIDTH, constants_files
from can_rig.export.compiler import built as compiled
from can_rig.export.law import law_files
from can_rig.export.trials import random_table
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.loading import load
from firmware_model.firmware import Firmware
from tests.helpers import asked, refused
from tests.rig.export.conftest import SCENARIOS
from tests.rig.export.shared import PRECISIONS, STRICT, run


def test_clang_does_not_warn(folder):
    """The fixture ``built`` compiles with gcc, where every warning is an error."""
    if shutil.which("clang") is None:
        pytest.skip("clang is not installed")
    sources = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*.[ch]")}
    del sources["main.c"], sources["check.c"]
    compiled(["clang"], [*STRICT, "-O2", "-ffp-contract=off"], sources, ".out")
    run("clang", *STRICT, "-fsyntax-only", folder / "main.c")


def test_cppcheck_finds_nothing(folder):
    if shutil.which("cppcheck") is None:
        pytest.skip("cppcheck is not installed")
    run("cppcheck", "--quiet", "--std=c99", "--enable=warning,performance,portability",
        "--error-exitcode=1", "--inline-suppr", folder)  # fmt: skip


def firmware_of(kind: str) -> Firmware:
    """The law in Python with the constants of a key of ``SCENARIOS``."""
    name, *options = SCENARIOS[kind]
    settings = [f'design.precision="{"float64" if kind == "float64" else "float32"}"']
    scenario = load(name, [*settings, *(each for each in options if "speeds" in each)])
    of = controls(scenario, network_of(scenario))
    return Firmware(of.table, speeds=of.schedule)


@pytest.mark.parametrize("kind", SCENARIOS)
def test_the_example_answers_as_the_firmware_does(kind, built):
    """Through all designs and past them; a value that is missing too."""
    random = np.random.default_rng(3)
    inputs = [[math.sin(k / 30), random.standard_normal() / 10] for k in range(200)]
    inputs[100][0] = math.nan
    if kind == "drive":
        inputs = [[*each, 5.0 + 30.0 * math.sin(k / 50) ** 2] for k, each in enumerate(inputs)]
        inputs[150][2] = math.nan
    text = "".join(" ".join(map(repr, each)) + "\n" for each in inputs)
    answers = run(built(kind) / "example", input=text).splitlines()
    firmware = firmware_of(kind)
    firmware.reset(0.0)
    assert len(answers) == len(inputs)
    for line, (reference, measurement, *speed) in zip(answers, inputs, strict=True):
        if speed:
            firmware.change_speed(*speed)
        expected = firmware.step(reference, measurement)
        assert tuple(map(float, line.split())) == tuple(map(float, expected))


def test_the_example_of_a_drive_wants_the_speed(built):
    program = [built("drive") / "example"]
    done = subprocess.run(program, input="0 0\n", capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "3 numbers: reference, measurement and speed" in done.stderr


def test_nothing_is_allocated_and_little_is_called(folder):
    """Of the C library: exact functions, and what fills memory."""
    symbols = run("nm", "--undefined-only", folder / "libfirmware.a").split()
    defined = run("nm", "--defined-only", folder / "libfirmware.a").split()
    outside = {each for each in symbols if each not in defined and re.fullmatch(r"[a-z_]\w+", each)}
    allowed = {"sqrt", "ceil", "rint", "fabs", "memset", "memcpy"}
    allowed |= {f"{each}f" for each in ("sqrt", "ceil", "rint", "fabs")}
    theirs = {"ecu_send", "_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    assert outside - theirs <= allowed


def test_it_reads_as_if_written_by_hand(folder):
    for path in folder.glob("*.[ch]"):
        text = path.read_text(encoding="utf-8")
        assert max(map(len, text.splitlines())) <= WIDTH + 4, path
        assert not re.search(r"[ \t]\n|\n\n\n|//:", text), path
    biquad = (folder / "biquad.h").read_text(encoding="utf-8")
    assert "/* Return the answer to 'u' in this tick; the state does not change. */" in biquad
    assert "real accumulators[8][2]; /* [output] s1, s2, a row a section */" in biquad


def test_single_precision_has_no_double(built):
    for path in built("float32").glob("*.[ch]"):
        code = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8"), flags=re.S)
        if path.stem not in ("main", "frames", "network", "ecu"):  # the law has none
            assert "double" not in code, path
            assert not re.search(r"\b\d+\.\d+(e[-+]?\d+)?(?![\df.e])", code), path


DUMP = """\
#include <stdio.h>
#include "constants.h"
int main(void)
{
    return (int)fwrite(&controller_table, sizeof controller_table, 1, stdout) - 1;
}
"""


@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_constant_is_exact(precision):
    """Tables of any numbers, infinite and subnormal ones too, come back from C bit for bit."""
    headers = {name: text for name, text in law_files(precision).items() if name.endswith(".h")}
    for seed in range(4):
        table = random_table(np.random.default_rng(seed), precision)
        files = {**headers, **constants_files(table[0], "Any."), "dump.c": DUMP}
        dump = compiled(["cc"], ["-std=c99"], files, ".out")
        got = np.frombuffer(subprocess.run([dump], capture_output=True, check=True).stdout,
                            table.dtype)  # fmt: skip
        real = table.dtype["tracking"]["feedback"]
        assert np.array_equal(got.view(real), table.view(real), equal_nan=True)


def test_the_header_says_units_ranges_and_timing():
    header = exported(load("default", []))[HEADER]
    assert "{" not in re.sub(r'(struct firmware_answer|extern "C") \{', "", header)
    for said in (
        "[N m] steering torque (SteerTorque), -400..400, steps of 0.001",
        "[m/s^2] FaultEstimate, -26.8435454..26.8435454",
        "once every 1 ms",
    ):
        assert said in header
    assert header.isascii()


def test_the_header_has_the_names_and_units_of_the_plant():
    header = exported(load("pendulum", ["plant.input_2.name='thrust */ {tick}'"]))[HEADER]
    for said in (
        "[N m] torque (Input1), -20..20, ",
        "[N] thrust * / {tick} (Input2), -40..40, ",
        "[rad] angle (Output), -21.47483647..21.47483647, ",
        "[rad] Reference, ",
    ):
        assert said in header


NODE_IN_CPP = """\
#include "ecu.h"
void ecu_send(const struct ecu *, uint32_t, uint8_t, const uint8_t *) {}
static struct ecu node;
int main()
{
    uint8_t data[8] = {0};

    ecu_init(&node);
    e2e_protect(&node.status, data, 8);
    return frame_value(&frame_feedback, 1u) > 0 ? ecu_is_overdue(&node, 0) : 1;
}
"""
BENCH_IN_CPP = """\
#include "bench.h"
bool bench_read(uint8_t *, uint32_t) { return false; }
bool bench_write(const uint8_t *, uint32_t) { return false; }
int main() { bench_run(); }
"""


@pytest.mark.parametrize("program", [NODE_IN_CPP, BENCH_IN_CPP])
def test_a_program_in_cpp_links_it(program, folder, tmp_path):
    compiler = shutil.which("c++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler is installed")
    app, built = tmp_path / "app", [folder / "libfirmware.a"]
    if program == BENCH_IN_CPP:
        built = [folder / "bench.o", folder / "harness.o", *built]
    (tmp_path / "app.cc").write_text(program)
    run(compiler, "-Wall", "-Werror", f"-I{folder}", f"{app}.cc", *built, "-lm", "-o", app)
    run(app)


def test_force_writes_over_an_export_and_keeps_what_else_is_there(tmp_path):
    made = tmp_path / "ecu"
    made.mkdir()  # an empty folder is as good as none
    write({HEADER: "old", "law.c": "old"}, made, force=False)
    (made / "can_driver.c").write_text("mine")
    command = ["export", "default", "--out", made]
    assert "--force" in refused(*command)
    assert asked(*command, "--force").returncode == 0
    found = {path.name: path.read_text() for path in made.iterdir()}
    assert found == exported(load("default", [])) | {"law.c": "old", "can_driver.c": "mine"}
