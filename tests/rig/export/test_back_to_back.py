"""The law in C against the law in Python: the same bits after every tick, whatever the memory.

Compiled at every level, with sanitizers, and on emulated boards.
"""

import ctypes
import math
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from can_rig.controllers.compiled_law import CompiledLaw
from can_rig.controllers.ecus import host_library
from can_rig.errors import ExportError
from can_rig.export.application import application, bench, in_precision
from can_rig.export.boards import emulated, image_of
from can_rig.export.compiler import FLAGS, built, shared_library
from can_rig.export.law import law_files, support
from can_rig.export.trials import (
    HOST_FLAGS,
    Trial,
    as_orders,
    different,
    encoded,
    in_python,
    on_host,
    random_table,
    random_trials,
    states_of,
    trial_files,
)
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.loading import load
from firmware_model.firmware import Firmware, Law
from firmware_model.law.layout import State, state_type, table_type
from firmware_model.law.schedule import MAX_SPEEDS
from firmware_model.law.status import FaultState
from firmware_model.law.structs import Precision, zeroed
from tests.rig.export.shared import EMULATED, PRECISIONS

MEMORIES, TICKS = 100, 12
SANITIZED = (
    "-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all",
)  # fmt: skip


def host_program(law: Mapping[str, str], compiler: list[str], flags: Iterable[str]) -> Path:
    files = trial_files(law) | {"bench_main.c": support("bench_main.c")}
    return built(compiler, [*HOST_FLAGS, *flags], files, ".out")


def on_board(law: Mapping[str, str], board: str, orders: bytes) -> bytes:
    image = image_of(trial_files(law), "board_ecu.c", board)
    return emulated(image, board, {"orders": orders}, "answers")


@cache
def trials(precision: Precision, blends: bool = False) -> list[Trial]:
    return random_trials(precision, 7, MEMORIES, TICKS, blends)


@cache
def expected(precision: Precision, blends: bool = False) -> bytes:
    return in_python(trials(precision, blends))


def differing(answers: bytes, precision: Precision, blends: bool = False) -> int:
    """Number of states that differ from Python's."""
    return different(expected(precision, blends), answers, trials(precision, blends))


def answers_of(law: Law, precision: Precision) -> bytes:
    return b"".join(states_of(law, trials(precision)))


@pytest.mark.parametrize(
    ("compiler", "level", "precision"),
    [("gcc", "-O0", "float64"), ("gcc", "-O2", "float64"), ("gcc", "-O2", "float32"),
     ("clang", "-O3", "float32")],
)  # fmt: skip
def test_every_bit_of_the_state_is_the_same(compiler, level, precision):
    """-O1 is the sanitizers' level."""
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    flags = [level if flag == "-O2" else flag for flag in FLAGS]
    law = CompiledLaw(precision, built([compiler], flags, law_files(precision), ".so"))
    assert differing(answers_of(law, precision), precision) == 0


def test_another_law_has_other_bits():
    files = dict(law_files("float64"))
    files["biquad.c"] = files["biquad.c"].replace("[i][1] * u -", "[i][1] * u +")
    assert files != law_files("float64")
    answers = answers_of(CompiledLaw("float64", shared_library(files)), "float64")
    assert differing(answers, "float64") > 100
    assert differing(answers[:-1], "float64") == MEMORIES * (TICKS + 1)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_structs_lie_where_numpy_has_them(precision):
    """C says the offset of every field, as assertions that a compiler checks."""
    lines = ["#include <stddef.h>", '#include "layout.h"']

    def check(struct: str, dtype: np.dtype[np.void], path: str = "", base: int = 0) -> None:
        assert dtype.fields is not None
        for name, (kind, offset, *_) in dtype.fields.items():
            place = f"{path}{name}"
            lines.append(
                f"typedef char at_{len(lines)}"
                f"[offsetof(struct {struct}, {place}) == {base + offset} ? 1 : -1];"
            )
            if kind.names:
                check(struct, kind, f"{place}.", base + offset)

    for struct, dtype in (("layout_table", table_type), ("layout_state", state_type)):
        check(struct, dtype(precision))
        size = dtype(precision).itemsize
        lines.append(f"typedef char size_{struct}[sizeof(struct {struct}) == {size} ? 1 : -1];")
    assert len(lines) > 150
    headers = {name: text for name, text in law_files(precision).items() if name.endswith(".h")}
    shared_library({**headers, "offsets.c": "\n".join(lines) + "\n"})


def test_inputs_that_are_missing_are_held():
    tables = random_table(np.random.default_rng(5), "float64")
    tables[0].monitor.enabled, tables[0].prediction.longest = 0, math.inf
    law = CompiledLaw("float64")
    states = law.init(tables[0])
    *_, mode, _, _ = law.step_of(tables, states)(math.nan, 0.0)
    assert mode == 2


@pytest.fixture(scope="module")
def sanitizers():
    """The libraries that this takes are packages of their own."""
    command = ["gcc", *SANITIZED, "-x", "c", "-", "-o", "/dev/null"]
    program = b"int main(void) { return 0; }"
    if subprocess.run(command, input=program, capture_output=True, check=False).returncode:
        pytest.skip("gcc has no sanitizers here")


@pytest.mark.usefixtures("sanitizers")
@pytest.mark.parametrize(
    ("precision", "blends"), [("float64", False), ("float32", False), ("float64", True)]
)
def test_no_sanitizer_stops_the_law(precision, blends):
    program = host_program(law_files(precision, blends), ["gcc"], SANITIZED)
    answers = on_host(program, encoded(trials(precision, blends)))
    assert differing(answers, precision, blends) == 0


@pytest.mark.usefixtures("sanitizers")
def test_no_sanitizer_stops_the_node():
    scenario = load("default", [])
    node = application(scenario)
    files = node | bench(node) | {"bench_main.c": support("bench_main.c")}
    program = built(["gcc"], [*HOST_FLAGS, *SANITIZED], files, ".out")
    orders = as_orders(network_of(scenario), range(20), round(scenario.tick_s * 1e6))
    assert len(on_host(program, orders)) > 30_000


@pytest.mark.usefixtures("sanitizers")
def test_a_sanitizer_stops_what_is_wrong():
    files = dict(law_files("float64"))
    files["exponential.c"] = files["exponential.c"].replace("(int32_t)n;", "(int32_t)(n + 1e30);")
    assert files != law_files("float64")
    with pytest.raises(ExportError, match=r"the trial ended: .*error"):
        on_host(host_program(files, ["gcc"], SANITIZED), encoded(trials("float64")))


@EMULATED
@pytest.mark.parametrize(
    ("board", "precision", "blends"),
    [("m4f", "float32", True), ("m7", "float32", False), ("m7", "float64", False)],
)
def test_a_board_has_every_bit_of_the_state(board, precision, blends):
    # Not float64 on an M4F: libgcc's 1 - x has a wrong last bit for some x near 2^-33.
    answers = on_board(law_files(precision, blends), board, encoded(trials(precision, blends)))
    assert differing(answers, precision, blends) == 0


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("s[m][0] += ", "s[m][0] -= "),  # states
        ("loop_inverse = ", "loop_inverse = 2.0 * "),  # the table
        ("own->place = place", "own->place = 0.0"),  # the blending
    ],
)
def test_a_change_of_speed_that_differs_is_found(right, wrong):
    files = dict(law_files("float64", blends=True))
    files["schedule.c"] = files["schedule.c"].replace(right, wrong)
    assert files != law_files("float64", blends=True)
    answers = on_host(host_program(files, ["cc"], ["-O0"]), encoded(trials("float64", blends=True)))
    assert differing(answers, "float64", blends=True) > 100


def test_random_speeds_are_of_every_kind():
    """At, between and past the designs, and not finite; tables and turns that it moves."""
    drives = [each.drive for each in trials("float32", blends=True) if each.drive is not None]
    assert len(drives) == MEMORIES
    assert {int(drive.schedules["n"][0]) for drive in drives} >= {1, 2, MAX_SPEEDS}
    speeds = np.concatenate([drive.speeds for drive in drives])
    assert np.isnan(speeds).any()
    assert {np.inf, -np.inf} <= set(speeds.tolist())
    designs = [drive.schedules["speed"][0, : drive.schedules["n"][0]] for drive in drives]
    for known in designs:
        assert (np.diff(known) > 0).all()
    pairs = [(drive.speeds, known) for drive, known in zip(drives, designs, strict=True)]
    assert any(np.isin(each, known).any() for each, known in pairs)
    assert any((each < known[0]).any() and (each > known[-1]).any() for each, known in pairs)


def address(memory: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(memory.ctypes.data)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_c_saves_the_bytes_of_python_and_refuses_every_flipped_bit(precision):
    scenario = in_precision(load("default", []), precision)
    of = controls(scenario, network_of(scenario))
    code = ctypes.CDLL(str(host_library(scenario)))
    code.firmware_restore.restype = ctypes.c_bool
    firmware = Firmware(of.table)
    for tick in range(1500):  # no motion of the car answers the commands: a loss
        answer = firmware.step(math.sin(0.003 * tick), 0.001 * (tick % 7 - 3))
    assert answer.fault_state == FaultState.CONFIRMED
    whole = firmware.saved()

    state = firmware._states.copy()
    before = state.tobytes()
    saved = ctypes.create_string_buffer(len(whole))
    code.firmware_save(address(state), saved)
    assert saved.raw == whole
    assert state.tobytes() == before

    fresh = zeroed(State, precision)
    code.firmware_init(address(fresh))
    before = fresh.tobytes()
    for bit in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        assert not code.firmware_restore(address(fresh), bytes(damaged)), bit
    assert fresh.tobytes() == before
    assert code.firmware_restore(address(fresh), whole)
    assert fresh["supervision"]["saved"].tobytes() == whole
    code.firmware_save(address(fresh), saved)
    assert saved.raw == whole
