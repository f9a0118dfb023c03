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
from can_rig.export.back_to_back.memories import random_table
from can_rig.export.constants import constants_source
from can_rig.export.folder import exported, in_precision
from can_rig.export.law import law_files
from can_rig.export.running.compiler import WARNINGS
from can_rig.export.writing.c_text import WIDTH
from can_rig.scenario.build import controller_table, network_of
from firmware_model.firmware import Firmware
from firmware_model.target.structs import Precision
from tests.rig.export.test_bits import PRECISIONS

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
    assert "/* The answer to 'u' in this tick; the state stays as it is. */" in biquad
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
        files = {**law_files(precision), "constants.c": constants_source(table[0], "Any.")}
        files["constants.h"] = '#include "layout.h"\n'
        files["dump.c"] = (
            '#include <stdio.h>\n#include "constants.h"\n'
            "extern const struct layout_table controller_table;\n"
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
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 2
    assert "--force" in done.stderr
    assert CliRunner().invoke(main, [*command, "--force"]).exit_code == 0
    assert (tmp_path / "firmware.h").is_file()


def test_the_header_says_units_ranges_and_timing() -> None:
    header = exported(load("default", []))["firmware.h"]
    assert "{" not in re.sub(r"struct firmware_answer \{", "", header)
    for said in ("[N.m] SteerTorque, -", "[m/s^2] ", "once every 1 ms", "steps of 0.001"):
        assert said in header


def _precision(folder: Path) -> Precision:
    return "float32" if folder.name == "float32" else "float64"
