"""Two exports in one program: every external name has its prefix, and each answers as if alone."""

import math
import re
import shutil

import pytest

from tests.helpers import refused, succeeded
from tests.rig.export.shared import STRICT, run

EXPORTS = {
    "front": ["cluster", "--precision", "float32"],
    "rear_2": ["drive-cycle", "--set", "design.speeds_mps=[8.0, 8.9, 10.0]"],
}
"""Of different precision and structs, one with further sensors, one with changes of the speed."""

BOTH = """\
#include <stdio.h>

#include "front/ecu.h"
#include "rear_2/ecu.h"

static struct front_ecu front, second;
static struct rear_2_ecu rear;
static int sent[3];

void front_ecu_send(const struct front_ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data)
{
    (void)id;
    (void)length;
    (void)data;
    sent[ecu == &front ? 0 : 1]++;
}

void rear_2_ecu_send(const struct rear_2_ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data)
{
    (void)ecu;
    (void)id;
    (void)length;
    (void)data;
    sent[2]++;
}

int main(int argc, char **argv)
{
    double reference, measurement;

    (void)argv;
    if (!front_ecu_init(&front) || !front_ecu_init(&second) || !rear_2_ecu_init(&rear)) {
        return 1;
    }
    front_firmware_reset(&front.state, 0.0f);
    rear_2_firmware_reset(&rear.state, 0.0);
    while (argc == 1 && scanf("%lf %lf", &reference, &measurement) == 2) {
        const struct front_firmware_answer one =
            front_firmware_step(&front.state, (front_real)reference, (front_real)measurement);
        rear_2_firmware_change_speed(&rear.state, 8.5);
        const struct rear_2_firmware_answer two =
            rear_2_firmware_step(&rear.state, (rear_2_real)reference, (rear_2_real)measurement);
        printf("%.17g %.17g %.17g %.17g %d %d\\n",
               (double)one.command_1, (double)one.fault_estimate, (double)two.command_1,
                (double)two.fault_estimate, (int)one.mode, (int)two.mode);
    }
    front_ecu_on_tick(&front);
    front_ecu_on_tick(&second);
    rear_2_ecu_on_tick(&rear);
    if ((int)FRONT_MODE_RUN != (int)REAR_2_MODE_RUN) {
        return 2;
    }
    return sent[0] == 3 && sent[1] == 3 && sent[2] == 3 ? 0 : 3;
}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Both exports with a prefix, and as ``alone-PREFIX`` without; built without a warning."""
    folder = tmp_path_factory.mktemp("two")
    for prefix, scenario in EXPORTS.items():
        for name, options in ((prefix, ["--prefix", prefix]), (f"alone-{prefix}", [])):
            out = folder / name
            succeeded("export", *scenario, *options, "--out", out)
            flags = f"CFLAGS={' '.join(STRICT)} -O0"
            run("make", "-s", "-C", out, flags, "example", *(["bench", "check"] if options else []))
    return folder


def test_both_run_side_by_side_as_each_does_alone(place):
    """Their headers in one file, and two nodes of one export."""
    (place / "both.c").write_text(BOTH, encoding="utf-8")
    libraries = [place / prefix / f"lib{prefix}_firmware.a" for prefix in EXPORTS]
    run("gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "both.c", *libraries, "-lm", "-o", "both",
        cwd=place)  # fmt: skip
    inputs = [(math.sin(k / 30), 0.8 * math.sin(k / 30 - 0.4)) for k in range(300)]
    inputs[100] = (math.nan, 0.1)
    text = "".join(f"{r!r} {y!r}\n" for r, y in inputs)
    answers = [
        list(map(float, line.split())) for line in run(place / "both", input=text).splitlines()
    ]
    speed = text.replace("\n", " 8.5\n")
    alone = [
        [
            list(map(float, line.split()))
            for line in run(place / name / "example", input=given).splitlines()
        ]
        for name, given in (("alone-front", text), ("alone-rear_2", speed))
    ]
    assert len(answers) == len(inputs)
    for both, one, two in zip(answers, *alone, strict=True):
        assert both == [one[0], one[2], two[0], two[2], one[3], two[3]]


@pytest.mark.parametrize("prefix", EXPORTS)
def test_every_external_name_has_the_prefix_and_none_is_of_something_that_changes(
    prefix, place, tmp_path
):
    sources = [each for each in (place / prefix).glob("*.c") if "main" not in each.name]
    run("gcc", "-std=c99", "-fno-pie", "-c", *sources, cwd=tmp_path)  # constants with addresses too
    objects = [*tmp_path.glob("*.o")]
    symbols = [
        line.split()
        for line in run("nm", "--extern-only", "--defined-only", *objects).splitlines()
        if line.count(" ") == 2
    ]
    assert {kind for _, kind, _ in symbols} <= {"T", "R"}
    names = {name for *_, name in symbols} - {"main"}
    assert len(names) > 80
    assert all(name.startswith(f"{prefix}_") for name in names)


@pytest.mark.parametrize("prefix", EXPORTS)
def test_nothing_else_changes(prefix, place):
    """Without the prefix in it, each file is that of the export without."""
    for path in (place / f"alone-{prefix}").iterdir():
        if path.suffix in (".c", ".h", ".toml") or path.name in ("Makefile", "CMakeLists.txt"):
            text = (place / prefix / path.name).read_text(encoding="utf-8")
            bare = re.sub(rf"\b(lib)?{prefix}_", r"\1", text).replace(f"{prefix.upper()}_", "")
            assert bare == path.read_text(encoding="utf-8"), path


def test_cmake_takes_both_into_one_project(place, tmp_path):
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    (tmp_path / "both.c").write_text(BOTH, encoding="utf-8")
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.13)\nproject(two C)\nenable_testing()\n"
        + "".join(f"add_subdirectory({place / each} {each})\n" for each in EXPORTS)
        + f"add_executable(both both.c)\ntarget_include_directories(both PRIVATE {place})\n"
        "target_link_libraries(both front_firmware rear_2_firmware m)\n"
        "add_test(NAME both COMMAND both alone)\n"
    )
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build")
    run("cmake", "--build", tmp_path / "build", "-j2")
    said = run("ctest", "--test-dir", tmp_path / "build")
    assert re.search(r"100% tests passed.* out of 3", said)  # CMake 4 has other words between


def test_one_file_includes_both_after_their_installation(place, tmp_path):
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    for prefix in EXPORTS:
        run("cmake", "-S", place / prefix, "-B", tmp_path / prefix)
        run("cmake", "--build", tmp_path / prefix, "-j2")
        run("cmake", "--install", tmp_path / prefix, "--prefix", tmp_path / "opt")
    installed = BOTH.replace('"front/', '"front_firmware/').replace('"rear_2/', '"rear_2_firmware/')
    (tmp_path / "both.c").write_text(installed, encoding="utf-8")
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.13)\nproject(two C)\nadd_executable(both both.c)\n"
        + "".join(
            f"find_package({each}_firmware CONFIG REQUIRED)\n"
            f"target_link_libraries(both {each}_firmware::{each}_firmware)\n"
            for each in EXPORTS
        )
    )
    run(
        "cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={tmp_path / 'opt'}"
    )
    run("cmake", "--build", tmp_path / "build")
    run(tmp_path / "build" / "both", "alone")


@pytest.mark.parametrize("prefix", ["", "2nd", "Front", "a-b", "a b"])
def test_another_prefix_is_refused(prefix, tmp_path):
    line = refused("export", "default", "--prefix", prefix, "--out", tmp_path / "out")
    assert f"--prefix {prefix!r}: must have lower-case letters, digits and _" in line
    assert not (tmp_path / "out").exists()
