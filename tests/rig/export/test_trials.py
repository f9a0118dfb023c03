"""Random memory through the C: with sanitizers, and on emulated boards."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache

import pytest

from can_rig.assessment.resolve import load
from can_rig.errors import ExportError
from can_rig.export.application import application
from can_rig.export.back_to_back.frames import as_orders
from can_rig.export.back_to_back.programs import HOST_FLAGS, host_program, on_board, on_host
from can_rig.export.back_to_back.trials import Trial, different, encoded, in_python, random_trials
from can_rig.export.law import law_files, support
from can_rig.export.running.compiler import built
from can_rig.export.running.ecu import bench
from can_rig.export.running.emulated_ecu import COMPILER, EMULATOR
from can_rig.scenario.build import network_of
from firmware_model.target.structs import Precision
from tests.rig.export.test_bits import PRECISIONS

SANITIZED = (
    "-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all",
)  # fmt: skip


@cache
def trials(precision: Precision) -> list[Trial]:
    return random_trials(precision, 7, 60, 12)


def sanitizes(compiler: str) -> bool:
    """Whether it can: the libraries that this takes are packages of their own."""
    command = [compiler, *SANITIZED, "-x", "c", "-", "-o", "/dev/null"]
    program = b"int main(void) { return 0; }"
    return (
        shutil.which(compiler) is not None
        and not subprocess.run(command, input=program, capture_output=True, check=False).returncode
    )


NEEDS_SANITIZERS = pytest.mark.skipif(not sanitizes("gcc"), reason="gcc has no sanitizers here")


@NEEDS_SANITIZERS
@pytest.mark.parametrize("precision", PRECISIONS)
def test_no_sanitizer_stops_the_law(precision: Precision) -> None:
    program = host_program(law_files(precision), ["gcc"], SANITIZED)
    answers = on_host(program, encoded(trials(precision)))
    assert different(in_python(trials(precision)), answers, trials(precision)) == 0


@NEEDS_SANITIZERS
def test_no_sanitizer_stops_the_node() -> None:
    scenario = load("default", [])
    whole = application(scenario)
    files = whole | bench(whole) | {"bench_main.c": support("bench_main.c")}
    program = built(["gcc"], [*HOST_FLAGS, *SANITIZED], files, ".out")
    orders = as_orders(network_of(scenario), range(20), 1000)
    assert len(on_host(program, orders)) > 30_000


@NEEDS_SANITIZERS
def test_a_sanitizer_stops_what_is_wrong() -> None:
    files = dict(law_files("float64"))
    files["exponential.c"] = files["exponential.c"].replace("(int32_t)n;", "(int32_t)(n + 1e30);")
    assert files != law_files("float64")
    with pytest.raises(ExportError, match=r"the trial ended: .*error"):
        on_host(host_program(files, ["gcc"], SANITIZED), encoded(trials("float64")))


@pytest.mark.skipif(
    shutil.which(COMPILER) is None or shutil.which(EMULATOR) is None,
    reason=f"{COMPILER} or {EMULATOR} is not installed",
)
@pytest.mark.parametrize(
    ("board", "precision"), [("m4f", "float32"), ("m7", "float32"), ("m7", "float64")]
)
def test_a_board_has_every_bit_of_the_state(board: str, precision: Precision) -> None:
    # Not float64 on an M4F: libgcc's 1 - x has a wrong last bit for some x near 2^-33.
    answers = on_board(law_files(precision), board, encoded(trials(precision)))
    assert different(in_python(trials(precision)), answers, trials(precision)) == 0


def test_a_law_that_differs_is_found() -> None:
    files = dict(law_files("float64"))
    files["biquad.c"] = files["biquad.c"].replace("[i][1] * u -", "[i][1] * u +")
    answers = on_host(host_program(files, ["cc"], ["-O1"]), encoded(trials("float64")))
    assert different(in_python(trials("float64")), answers, trials("float64")) > 100
    assert different(in_python(trials("float64")), answers[:-1], trials("float64")) == 60 * 13
