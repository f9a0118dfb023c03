"""The exported folder: what stands in it, that it builds without a warning, and that it runs."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from can_rig.assessment.resolve import load
from can_rig.cli.main import main
from can_rig.errors import RunFolderError
from can_rig.export.application import HEADER, exported, in_precision, write
from can_rig.export.c_files import constants_files
from can_rig.export.c_text import WIDTH
from can_rig.export.compiler import WARNINGS
from can_rig.export.law import law_files
from can_rig.export.trials import random_table
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.driving import controls
from firmware_model.firmware import Firmware
from firmware_model.target.structs import Precision
from tests.rig.export.test_bits import PRECISIONS

NOT_FIRMWARE = {"main.c", "bench_main.c", "bench.c", "harness.c"}
FLAGS = ["-std=c99", "-Werror", *WARNINGS, "-Wstrict-prototypes", "-Wcast-qual", "-Wundef"]


def run(*command: str | Path, **options: str) -> str:
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, check=False, **options
    )  # type: ignore[call-overload]
    assert done.returncode == 0, done.stderr
    return str(done.stdout)


@pytest.fixture(scope="module", params=PRECISIONS)
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("export") / request.param
    command = ["export", "noisy", "--out", str(made), "--precision", request.param]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 0, done.output
    assert re.fullmatch(r".*: \d+ files, \d{4} lines of C\n", done.output.replace("\n", "") + "\n")
    return made


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_no_compiler_warns(folder: Path, compiler: str, tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    for source in folder.glob("*.c"):
        run(compiler, *FLAGS, "-O2", "-ffp-contract=off", "-c", source, "-o", tmp_path / "unit.o")


def test_cppcheck_finds_nothing(folder: Path) -> None:
    if shutil.which("cppcheck") is None:
        pytest.skip("cppcheck is not installed")
    run("cppcheck", "--quiet", "--std=c99", "--enable=warning,performance,portability",
        "--error-exitcode=1", "--inline-suppr", folder)  # fmt: skip


def test_the_example_answers_as_the_firmware_does(folder: Path, tmp_path: Path) -> None:
    built = tmp_path / "built"
    shutil.copytree(folder, built)
    run("make", "-s", "-C", built)
    random = np.random.default_rng(3)
    inputs = [(math.sin(k / 30), random.standard_normal() / 10) for k in range(300)]
    inputs[100] = (math.nan, 0.0)
    text = "".join(f"{reference!r} {measurement!r}\n" for reference, measurement in inputs)
    answers = run(built / "example", input=text).splitlines()
    scenario = in_precision(load("noisy", []), _precision(folder))
    firmware = Firmware(controller_table(scenario, network_of(scenario)))
    firmware.reset(0.0)
    assert len(answers) == len(inputs)
    for line, (reference, measurement) in zip(answers, inputs, strict=True):
        expected = firmware.step(reference, measurement)
        assert tuple(map(float, line.split())) == tuple(map(float, expected))


def test_the_example_of_a_drive_reads_the_speed(tmp_path: Path) -> None:
    """Through all designs and past them; a speed that is missing is the last one."""
    scenario = load(
        "drive-cycle", ['design.precision="float32"', "design.speeds_mps=[8.0, 8.9, 10.0]"]
    )
    for name, text in exported(scenario).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    run("make", "-s", "-C", tmp_path, f"CFLAGS={' '.join(FLAGS)} -O1")
    speeds = [5.0 + 30.0 * math.sin(k / 50) ** 2 for k in range(200)]
    speeds[150] = math.nan
    inputs = [(math.sin(k / 30), math.sin(k / 30 - 0.4), speed) for k, speed in enumerate(speeds)]
    text = "".join(f"{r!r} {y!r} {speed!r}\n" for r, y, speed in inputs)
    answers = run(tmp_path / "example", input=text).splitlines()
    of = controls(scenario, network_of(scenario))
    firmware = Firmware(of.table, speeds=of.schedule)
    firmware.reset(0.0)
    assert len(answers) == len(inputs)
    for line, (reference, measurement, speed) in zip(answers, inputs, strict=True):
        firmware.change_speed(speed)
        expected = firmware.step(reference, measurement)
        assert tuple(map(float, line.split())) == tuple(map(float, expected))
    program = [tmp_path / "example"]
    done = subprocess.run(program, input="0 0\n", capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "3 numbers: reference, measurement and speed" in done.stderr


def test_cmake_builds_it_too(folder: Path, tmp_path: Path) -> None:
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    run("cmake", "-S", folder, "-B", tmp_path)
    run("cmake", "--build", tmp_path)
    assert run(tmp_path / "example", input="0 0\n").split()[3] == "1"


def test_nothing_is_allocated_and_little_is_called(folder: Path, tmp_path: Path) -> None:
    """Of the C library: exact functions, and what fills memory."""
    shutil.copytree(folder, tmp_path / "built")
    run("make", "-s", "-C", tmp_path / "built", "libfirmware.a")
    symbols = run("nm", "--undefined-only", tmp_path / "built" / "libfirmware.a").split()
    defined = run("nm", "--defined-only", tmp_path / "built" / "libfirmware.a").split()
    outside = {each for each in symbols if each not in defined and re.fullmatch(r"[a-z_]\w+", each)}
    allowed = {"sqrt", "ceil", "rint", "fabs", "memset", "memcpy"}
    allowed |= {f"{each}f" for each in ("sqrt", "ceil", "rint", "fabs")}
    theirs = {"ecu_send", "_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    assert outside - theirs <= allowed


def test_it_reads_as_if_written_by_hand(folder: Path) -> None:
    for path in folder.glob("*.[ch]"):
        text = path.read_text(encoding="utf-8")
        assert max(map(len, text.splitlines())) <= WIDTH + 4, path
        assert not re.search(r"[ \t]\n|\n\n\n", text), path
    biquad = (folder / "biquad.h").read_text(encoding="utf-8")
    assert "/* Return the answer to 'u' in this tick; the state does not change. */" in biquad
    assert "real accumulators[8][2]; /* [output] s1, s2, a row a section */" in biquad


def test_single_precision_has_no_double(folder: Path) -> None:
    if _precision(folder) == "float64":
        return
    for path in folder.glob("*.[ch]"):
        code = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8"), flags=re.S)
        if path.stem not in ("main", "frames", "network", "ecu"):  # the law has none
            assert "double" not in code, path
            assert not re.search(r"\b\d+\.\d+(e[-+]?\d+)?(?![\df.e])", code), path


@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_constant_is_exact(precision: Precision, tmp_path: Path) -> None:
    """Tables of any numbers, infinite and subnormal ones too, come back from C bit for bit."""
    for seed in range(4):
        table = random_table(np.random.default_rng(seed), precision)
        files = {**law_files(precision), **constants_files(table[0], "Any.")}
        files["dump.c"] = (
            '#include <stdio.h>\n#include "constants.h"\n'
            "int main(void) { return (int)fwrite(&controller_table, sizeof controller_table, 1,"
            " stdout) - 1; }\n"
        )
        place = tmp_path / str(seed)
        place.mkdir()
        for name, text in files.items():
            (place / name).write_text(text, encoding="utf-8")
        run("cc", "-std=c99", place / "dump.c", place / "constants.c", "-o", place / "dump")
        found = subprocess.run([place / "dump"], capture_output=True, check=True).stdout
        got = np.frombuffer(found, table.dtype)
        same = np.array_equal(
            got.view(table.dtype["tracking"]["feedback"]),
            table.view(table.dtype["tracking"]["feedback"]),
            equal_nan=True,
        )
        assert same


def test_an_existing_folder_stays(tmp_path: Path) -> None:
    command = ["export", "default", "--out", str(tmp_path)]
    assert CliRunner().invoke(main, command).exit_code == 0  # an empty folder is as good as new
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 2
    assert "--force" in done.stderr
    assert CliRunner().invoke(main, [*command, "--force"]).exit_code == 0
    assert (tmp_path / "firmware.h").is_file()


def test_the_header_says_units_ranges_and_timing() -> None:
    header = exported(load("default", []))["firmware.h"]
    assert "{" not in re.sub(r'(struct firmware_answer|extern "C") \{', "", header)
    for said in (
        "[N m] steering torque (SteerTorque), -400..400, steps of 0.001",
        "[m/s^2] FaultEstimate, -26.8435454..26.8435454",
        "once every 1 ms",
    ):
        assert said in header
    assert header.isascii()


def test_the_header_has_the_names_and_units_of_the_plant() -> None:
    header = exported(load("pendulum", ["plant.input_2.name='thrust */ {tick}'"]))["firmware.h"]
    for said in (
        "[N m] torque (Input1), -20..20, ",
        "[N] thrust * / {tick} (Input2), -40..40, ",
        "[rad] angle (Output), -21.47483647..21.47483647, ",
        "[rad] Reference, ",
    ):
        assert said in header


def test_a_program_in_cpp_links_it(folder: Path, tmp_path: Path) -> None:
    compiler = shutil.which("c++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler is installed")
    (tmp_path / "app.cc").write_text(
        '#include "ecu.h"\n'
        'extern "C" void ecu_send(uint16_t, const uint8_t *) {}\n'
        "static struct ecu node;\n"
        "int main() { ecu_init(&node); return ecu_is_overdue(&node, 0); }\n"
    )
    units = [path for path in sorted(folder.glob("*.c")) if path.name not in NOT_FIRMWARE]
    run("cc", "-std=c99", "-c", *units, cwd=tmp_path)
    objects = sorted(tmp_path.glob("*.o"))
    app = tmp_path / "app"
    run(compiler, "-Wall", "-Werror", f"-I{folder}", f"{app}.cc", *objects, "-lm", "-o", app)
    run(tmp_path / "app")


def _precision(folder: Path) -> Precision:
    return "float32" if folder.name == "float32" else "float64"


def test_force_writes_over_an_export_and_keeps_what_else_is_there(tmp_path: Path) -> None:
    write({HEADER: "old", "law.c": "old"}, tmp_path / "ecu", force=False)
    (tmp_path / "ecu" / "can_driver.c").write_text("mine")
    write({HEADER: "new", "law.c": "new"}, tmp_path / "ecu", force=True)
    found = {path.name: path.read_text() for path in (tmp_path / "ecu").iterdir()}
    assert found == {HEADER: "new", "law.c": "new", "can_driver.c": "mine"}


@pytest.mark.parametrize("out", [".", "work", "work/..", "/"])
def test_force_writes_into_no_other_folder(
    out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "work").mkdir()
    for kept in ("thesis.txt", "work/notes.txt"):
        (tmp_path / kept).write_text("mine")
    with pytest.raises(RunFolderError, match="not an exported controller, so --force does not"):
        write({HEADER: "new"}, Path(out), force=True)
    assert {path.name for path in tmp_path.rglob("*")} == {"thesis.txt", "work", "notes.txt"}


def test_force_writes_into_an_empty_folder(tmp_path: Path) -> None:
    write({HEADER: "new"}, tmp_path, force=True)
    assert (tmp_path / HEADER).read_text() == "new"


def test_what_is_no_folder_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(RunFolderError, match="cannot be read: Not a directory"):
        write({HEADER: "new"}, tmp_path / "file", force=True)
