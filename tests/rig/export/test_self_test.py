"""The known-answer test of an export: right programs pass; wrong arithmetic or constants do not."""

import ctypes
import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from can_rig.controllers.ecus import HostEcu, host_library
from can_rig.errors import ExportError
from can_rig.export import boards
from can_rig.export.application import application, bench, identity
from can_rig.export.boards import RESTART, emulated, image_of, order
from can_rig.export.compiler import built as compiled
from can_rig.export.law import support
from can_rig.export.self_test import LOST, RESTARTED, known_answers
from can_rig.export.trials import as_orders, on_host
from can_rig.frames.codec import FRAME_BYTES
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware
from tests.rig.export.conftest import SCENARIOS
from tests.rig.export.shared import EMULATED, run

OPTIONS = (
    "-std=gnu17 -O3 -march=native -flto",
    "-O1 -march=native -ffp-contract=fast",
    "-O1 -fassociative-math -fno-signed-zeros -fno-trapping-math",
    "-O1 -freciprocal-math",
    "-O1 -ffast-math -U__FAST_MATH__ -U__FINITE_MATH_ONLY__ -U__ASSOCIATIVE_MATH__ "
    "-U__RECIPROCAL_MATH__ -U__NO_SIGNED_ZEROS__",
)
"""The last one is a compiler that hides what it does."""
INPUTS = "".join(
    f"{math.sin(k / 200)!r} {0.9 * math.sin(k / 200 - 0.3) + 0.01 * math.sin(k * k)!r}\n"
    for k in range(4000)
)


BOTH = """\
#include "self_test.h"
int example(void);
int main(int argc, char **argv)
{
    static struct layout_state memory;
    (void)argv;
    return argc > 1 ? example() : !self_test(&memory);
}
"""


def answers(
    folder: Path, compiler: str, options: str, place: Path, *emulator: str
) -> tuple[bool, str] | None:
    """Whether the self-test of a build succeeds, and what its example answers; None: no build."""
    (place / "both.c").write_text(BOTH, encoding="utf-8")
    other = ("check", "bench", "harness", "ecu", "e2e", "frames", "network")
    law = [path for path in folder.glob("*.c") if not path.name.startswith(other)]
    command = [compiler, *options.split(), "-w", f"-I{folder}", "-Dmain=example", "-c", *law]
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=place)
    if done.returncode:
        assert "the control law needs IEEE 754 arithmetic" in done.stderr
        return None
    linked = [compiler, *options.split(), f"-I{folder}", "both.c", *place.glob("*.o"), "-lm"]
    run(*linked, "-o", place / "both", cwd=place)
    program = (*emulator, place / "both")
    tested = subprocess.run(program, check=False, capture_output=True)
    assert tested.returncode in (0, 1)
    return tested.returncode == 0, run(*program, "example", input=INPUTS)


@pytest.mark.long
@pytest.mark.parametrize(
    ("processor", "options"), [("powerpc", "-std=gnu17 -O3"), ("riscv64", "-std=c99 -O2")]
)
def test_another_processor_computes_the_same(processor, options, built, tmp_path):
    """One with the high byte first, and both with fused instructions."""
    compiler = f"{processor}-linux-gnu-gcc"
    emulator = f"qemu-{processor.replace('powerpc', 'ppc')}"
    if shutil.which(compiler) is None or shutil.which(emulator) is None:
        pytest.skip(f"{compiler} or {emulator} is not installed")
    folder = built("float64")
    expected = run(folder / "example", input=INPUTS)
    found = answers(folder, compiler, f"{options} -static", tmp_path, emulator)
    assert found == (True, expected)


@pytest.mark.long
def test_half_precision_of_a_new_processor_is_no_refusal(built, tmp_path):
    """There gcc says FLT_EVAL_METHOD = 16: no float and no double is evaluated more widely."""
    check = ["gcc", "-std=gnu17", "-march=sapphirerapids", "-fsyntax-only"]
    (tmp_path / "none.c").touch()
    if subprocess.run([*check, tmp_path / "none.c"], check=False, capture_output=True).returncode:
        pytest.skip("gcc is not installed, or compiles for no such processor")
    run(*check, built("float32") / "biquad.c")


@pytest.mark.long
@pytest.mark.parametrize(("compiler", "precision"), [("gcc", "float64"), ("clang", "float32")])
def test_no_compiler_and_no_option_differs_silently(compiler, precision, built, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    folder = built(precision)
    expected, refused = run(folder / "example", input=INPUTS), set()
    for options in OPTIONS if compiler == "gcc" else (OPTIONS[0], *OPTIONS[3:]):
        found = answers(folder, compiler, options, tmp_path)
        if found is None or not found[0]:
            refused.add(options)
        else:
            assert found[1] == expected, options
    assert not {each for each in refused if each.startswith("-std")}
    assert OPTIONS[-1] in refused
    # clang has no macro for the parts of fast-math: its self-test finds what gcc may refuse.
    assert OPTIONS[2 if compiler == "gcc" else 3] in refused


FUSED = ("-std=gnu11", "-O2", "-mthumb", "-mfloat-abi=hard", "-fno-math-errno")


@EMULATED
@pytest.mark.parametrize("rounds", [True, False])
def test_a_board_with_fused_operations_is_kept_from_them_or_refused(rounds, monkeypatch):
    """gcc fuses for this board, outside -std=c99, unless ``rounding.h`` forbids."""
    monkeypatch.setattr(boards, "FLAGS", FUSED)
    node = application(load("default", ['design.precision="float32"']))
    files = node | bench(node) | ({} if rounds else {"rounding.h": ""})
    image = image_of(files, "board_ecu.c", "m4f")
    code = run("arm-none-eabi-objdump", "-d", image)
    assert ("vfma" in code) is not rounds
    said = emulated(image, "m4f", {"orders": order(RESTART, FRAME_BYTES)}, "answers")
    assert said == (identity(node) if rounds else bytes(8))


@pytest.mark.parametrize("kind", ["float32", "float64", "drive"])
def test_a_flipped_bit_of_any_constant_is_noticed(kind, built):
    folder = built(kind)
    files = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*.[ch]")}
    for name in ("main.c", "check.c", "bench_main.c", "bench.c"):
        del files[name]
    for name in ("constants.c", "constants.h"):  # in memory that can be written
        files[name] = files[name].replace("const struct", "struct")
    code = ctypes.CDLL(str(compiled(["cc"], ["-O1", "-fPIC", "-shared"], files, ".so")))
    code.self_test.restype = ctypes.c_bool
    memory = ctypes.create_string_buffer(1 << 16)
    assert code.self_test(memory)
    of = controls(scenario_of(kind), network_of(scenario_of(kind)))
    tables = [("controller_table", of.table), ("controller_schedule", of.schedule)]
    flipped = 0
    for name, record in tables[: 2 if kind == "drive" else 1]:
        assert record is not None
        place = (ctypes.c_uint8 * record.nbytes).in_dll(code, name)
        for at in value_bytes(record.dtype)[:: 1 if kind == "float32" else 101]:
            place[at] ^= 1 << at % 8
            assert not code.self_test(memory), (name, at)
            place[at] ^= 1 << at % 8
            flipped += 1
    assert flipped > 60
    assert code.self_test(memory)


@pytest.mark.parametrize("field", ["crc_of_constants", "fingerprint", "crc_of_answers"])
def test_a_flipped_bit_of_what_the_test_compares_with_is_noticed(field, built):
    node = {path.name: path.read_text(encoding="utf-8") for path in built("float32").glob("*.[ch]")}
    for name in ("main.c", "bench_main.c", "bench.c", "harness.c", "ecu.c", "network.c"):
        del node[name]
    right = re.search(rf"\.{field} = (0x\w+)u,", node["self_test_data.c"])
    assert right is not None
    wrong = right[0].replace(right[1], f"0x{int(right[1], 16) ^ 1 << 9:08X}")
    files = node | {"self_test_data.c": node["self_test_data.c"].replace(right[0], wrong)}
    program = compiled(["cc"], ["-std=c99"], files, ".out")
    assert subprocess.run([program], check=False, capture_output=True).returncode == 1


FRAME = [*range(7), *range(8, 32)]  # bytes of its numbers, which addresses of functions follow
SENSOR = [*FRAME, 48, *range(52, 68)]
SILENT = "void ecu_send(const struct ecu *e, uint32_t id, uint8_t n, const uint8_t *data)\n{\n}\n"


def starts(node: dict[str, str], *options: str) -> tuple[ctypes.CDLL, Any]:
    """A node as a library, and its ``ecu_init``."""
    files = node | {"silent.c": '#include "ecu.h"\n' + SILENT}
    code = ctypes.CDLL(str(compiled(["gcc"], ["-O1", "-fPIC", "-shared", *options], files, ".so")))
    memory = ctypes.create_string_buffer(1 << 16)
    code.ecu_init.restype = ctypes.c_bool
    return code, lambda: code.ecu_init(memory)


def test_a_flipped_bit_of_the_numbers_of_a_frame_is_noticed():
    """Of a sensor's frame and of the table of the CRC too, which no answer of the law shows."""
    node = application(load("cluster", ['design.precision="float32"']))
    constant = re.compile(r"const (struct (?:ecu_sensor_)?frame (?:frame_|ecu_sensors))")
    in_memory = {name: constant.sub(r"\1", text) for name, text in node.items()}
    code, start = starts(in_memory)
    assert start()
    roles = ("reference", "feedback", "command_1", "command_2", "status")
    places = [(f"frame_{role}", at) for role in roles for at in FRAME]
    for name, at in [*places, *(("ecu_sensors", 72 * n + at) for n in range(4) for at in SENSOR)]:
        place = (ctypes.c_uint8 * (4 * 72)).in_dll(code, name)
        place[at] ^= 1 << at % 8
        assert not start(), (name, at)
        place[at] ^= 1 << at % 8
    assert start()
    wrong = node | {"crc.c": node["crc.c"].replace("0x3Cu,", "0x3Du,")}
    assert wrong["crc.c"] != node["crc.c"]
    assert not starts(wrong)[1]()


def test_a_compiler_that_makes_double_literals_single_is_refused():
    """The law in single precision has none; a frame has."""
    node = application(load("default", ['design.precision="float32"']))
    assert starts(node)[1]()
    assert not starts(node, "-fsingle-precision-constant")[1]()


def scenario_of(kind: str) -> Scenario:
    """The scenario of a key of ``SCENARIOS``."""
    name, *options = SCENARIOS[kind]
    precision = "float64" if kind == "float64" else "float32"
    speeds = [each for each in options if "speeds" in each]
    return load(name, [f'design.precision="{precision}"', *speeds])


def value_bytes(dtype: np.dtype[np.void]) -> list[int]:
    """Offsets of all bytes of a record that are no padding."""
    if dtype.base.fields is None:
        return list(range(dtype.itemsize))
    if dtype.shape:  # an array of records
        each, size = value_bytes(dtype.base), dtype.base.itemsize
        return [start + at for start in range(0, dtype.itemsize, size) for at in each]
    return [offset + at for kind, offset, *_ in dtype.fields.values() for at in value_bytes(kind)]


def test_a_node_that_fails_stays_silent():
    """With one constant changed, whatever the node receives."""
    scenario = load("default", [])
    node = application(scenario)
    changed = node["constants.c"].replace(".n = 3,", ".n = 2,", 1)
    assert changed != node["constants.c"]
    orders = as_orders(network_of(scenario), range(1), round(scenario.tick_s * 1e6))
    whole = node | bench(node) | {"bench_main.c": support("bench_main.c")}
    for constants, is_fit in ((node["constants.c"], True), (changed, False)):
        files = whole | {"constants.c": constants}
        said = on_host(compiled(["cc"], ["-std=c99", "-O1"], files, ".out"), orders)
        assert said[:8] == (identity(node) if is_fit else bytes(8))
        counts = 2 * 10 * 4
        assert any(said[8:-counts]) is is_fit


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_processor_without_subnormal_numbers_is_refused(precision, built, tmp_path):
    """gcc's start-up code says so where only the linker gets ``-ffast-math``."""
    folder = built(precision)
    run("make", "-s", "-C", folder, "CC=gcc", "check")
    for option, status in (("-O1", 0), ("-ffast-math", 1)):
        run("gcc", option, folder / "check.o", folder / "libfirmware.a", "-lm", "-o", "checked",
            cwd=tmp_path)  # fmt: skip
        done = subprocess.run([tmp_path / "checked"], check=False, capture_output=True)
        assert done.returncode == status


def test_a_library_that_fails_is_refused(monkeypatch):
    scenario = load("default", [])
    HostEcu(host_library(scenario)).close()
    node = application(scenario)
    wrong = node | {"rounding.h": "", "biquad.c": node["biquad.c"].replace("* y +", "* y -")}
    assert wrong["biquad.c"] != node["biquad.c"]
    monkeypatch.setattr("can_rig.controllers.ecus.application", lambda _: wrong)
    library = host_library(scenario)
    with pytest.raises(ExportError, match="the self-test of the controller in C failed"):
        HostEcu(library)
    code, sent = ctypes.CDLL(str(library)), ctypes.create_string_buffer(64)
    code.harness_size.restype = ctypes.c_size_t
    ecu = ctypes.create_string_buffer(code.harness_size())
    code.ecu_init(ecu)
    code.harness_time(ecu, 0, sent)
    code.ecu_on_tick(ecu)  # an application that does not look at the answer of ecu_init
    assert not any(sent.raw)


@pytest.mark.parametrize("kind", ["float32", "float64", "drive"])
def test_make_runs_the_test(kind, built):
    assert "computes as in Python" in run("make", "-s", "-C", built(kind), "check")


def test_a_law_that_hears_further_sensors_answers_their_samples_too():
    of = controls(load("cluster", []), network_of(load("cluster", [])))
    heard, deaf = (known_answers(of, 1.0, hears) for hears in (True, False))
    assert heard.crc != deaf.crc
    assert "Verdict.ANOTHER_CAR" in {*heard.seen} - {*deaf.seen}  # the witnesses deny a fault


@pytest.mark.parametrize("name", ["default", "pendulum", "drive-cycle", "wltc"])
def test_the_stored_ticks_show_what_they_promise(name):
    """No fault, a loss, missing inputs, limits reached; of an unstable plant too."""
    scenario = load(name, [])
    of = controls(scenario, network_of(scenario))
    known = known_answers(of, scenario.reference.amplitude_mps2)
    assert {"Mode.RUN", "Mode.BLIND", "FaultState.CLEAR", "FaultState.SUSPECTED"} <= {*known.seen}
    assert "FaultState.CONFIRMED" in known.seen or name == "drive-cycle"
    assert ("Mode.STANDBY" in known.seen) is (name == "drive-cycle")
    firmware = Firmware(of.table, speeds=of.schedule)
    firmware.begin()
    steps = []
    for row in known.inputs.astype(float)[:RESTARTED]:
        if of.schedule is not None:
            firmware.change_speed(row[2])
        steps.append(firmware.step(row[0], row[1]))
    limits = (of.table.actuator_1.limit, of.table.actuator_2.limit)
    largest = np.abs(steps)[:, :2].max(axis=0)
    assert largest[0] == limits[0] or largest[1] == limits[1]
    assert max(abs(each.fault_estimate) for each in steps[: LOST.start]) < 1e-3
