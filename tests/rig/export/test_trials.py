"""Random memory through the C: with sanitizers, and on emulated boards."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.errors import ExportError
from can_rig.export.application import application, bench
from can_rig.export.compiler import built
from can_rig.export.ecus import COMPILER, EMULATOR
from can_rig.export.law import law_files, support
from can_rig.export.programs import HOST_FLAGS, as_orders, host_program, on_board, on_host
from can_rig.export.trials import Trial, different, encoded, in_python, random_trials
from can_rig.scenario.build import network_of
from firmware_model.target.schedule import MAX_SPEEDS
from firmware_model.target.structs import Precision

SANITIZED = (
    "-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all",
)  # fmt: skip


@cache
def trials(precision: Precision, blends: bool = False) -> list[Trial]:
    return random_trials(precision, 7, 60, 12, blends)


@cache
def expected(precision: Precision, blends: bool = False) -> bytes:
    return in_python(trials(precision, blends))


def law_of(precision: Precision, blends: bool) -> dict[str, str]:
    return law_files(precision, blends)


def differing(answers: bytes, precision: Precision, blends: bool) -> int:
    return different(expected(precision, blends), answers, trials(precision, blends))


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
@pytest.mark.parametrize(
    ("precision", "blends"), [("float64", False), ("float32", False), ("float64", True)]
)
def test_no_sanitizer_stops_the_law(precision: Precision, blends: bool) -> None:
    program = host_program(law_of(precision, blends), ["gcc"], SANITIZED)
    answers = on_host(program, encoded(trials(precision, blends)))
    assert differing(answers, precision, blends) == 0


@NEEDS_SANITIZERS
def test_no_sanitizer_stops_the_node() -> None:
    scenario = load("default", [])
    whole = application(scenario)
    files = whole | bench(whole) | {"bench_main.c": support("bench_main.c")}
    program = built(["gcc"], [*HOST_FLAGS, *SANITIZED], files, ".out")
    orders = as_orders(network_of(scenario), range(20), round(scenario.tick_s * 1e6))
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
    ("board", "precision", "blends"),
    [
        ("m4f", "float32", False),
        ("m4f", "float32", True),
        ("m7", "float32", False),
        ("m7", "float64", False),
    ],
)
def test_a_board_has_every_bit_of_the_state(board: str, precision: Precision, blends: bool) -> None:
    # Not float64 on an M4F: libgcc's 1 - x has a wrong last bit for some x near 2^-33.
    answers = on_board(law_of(precision, blends), board, encoded(trials(precision, blends)))
    assert differing(answers, precision, blends) == 0


def test_a_law_that_differs_is_found() -> None:
    files = dict(law_files("float64"))
    files["biquad.c"] = files["biquad.c"].replace("[i][1] * u -", "[i][1] * u +")
    answers = on_host(host_program(files, ["cc"], ["-O1"]), encoded(trials("float64")))
    assert differing(answers, "float64", blends=False) > 100
    assert differing(answers[:-1], "float64", blends=False) == 60 * 13


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("s[m][0] += ", "s[m][0] -= "),  # states
        ("loop_inverse = ", "loop_inverse = 2.0 * "),  # the table
        ("own->place = place", "own->place = 0.0"),  # the blending
    ],
)
def test_a_change_of_speed_that_differs_is_found(right: str, wrong: str) -> None:
    files = dict(law_of("float64", blends=True))
    files["schedule.c"] = files["schedule.c"].replace(right, wrong)
    assert files != law_of("float64", blends=True)
    answers = on_host(host_program(files, ["cc"], ["-O0"]), encoded(trials("float64", blends=True)))
    assert differing(answers, "float64", blends=True) > 100


def test_random_speeds_are_of_every_kind() -> None:
    """At, between and past the designs, and not finite; tables and turns that it moves."""
    drives = [each.drive for each in trials("float32", blends=True) if each.drive is not None]
    assert len(drives) == 60
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
