"""`support/trial.c` compiled and run: on this machine or on an emulated board."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from can_rig.errors import ExportError
from can_rig.export.law import filled, support
from can_rig.export.running.compiler import built
from can_rig.export.running.emulated_ecu import emulation, image_of
from can_rig.export.speed_words import words_of

HOST_FLAGS: Final = ("-std=c99", "-ffp-contract=off")
LONGEST_S: Final = 600.0


def trial_files(law: Mapping[str, str]) -> dict[str, str]:
    """The files of the law, and the trial that runs the law on any memory.

    The caller adds ``main``.

    Args:
        law: text by file name; `schedule.c` enables changes of speed.
    """
    chosen = words_of(law)
    return {**law, **{name: filled(support(name), **chosen) for name in ("bench.h", "trial.c")}}


def host_program(law: Mapping[str, str], compiler: Sequence[str], flags: Sequence[str]) -> Path:
    """The program for this machine.

    Raises:
        ExportError: the compiler refuses.
    """
    files = trial_files(law) | {"bench_main.c": support("bench_main.c")}
    return built(compiler, [*HOST_FLAGS, *flags], files, ".out")


def on_host(program: Path, orders: bytes) -> bytes:
    """The program's answers.

    Raises:
        ExportError: the program fails, or ignores orders; the message has the first line of its
            output.
    """
    try:
        done = subprocess.run(
            [program], input=orders, capture_output=True, check=False, timeout=LONGEST_S
        )
    except subprocess.TimeoutExpired:
        raise ExportError(f"the trial did not end within {LONGEST_S:g} s") from None
    if done.returncode or done.stderr:
        lines = done.stderr.decode(errors="replace").splitlines() or [f"{done.returncode}"]
        said = next((line for line in lines if "error" in line.lower()), lines[0])
        raise ExportError(f"the trial ended: {said}")
    return done.stdout


def on_board(law: Mapping[str, str], board: str, orders: bytes) -> bytes:
    """The answers of a board.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    image = image_of(trial_files(law), "board_ecu.c", board)
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        (Path(place) / "orders").write_bytes(orders)
        command = emulation(image, board)
        try:
            subprocess.run(command, cwd=place, capture_output=True, check=True, timeout=LONGEST_S)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
            raise ExportError(f"the emulator did not end: {error}") from None
        return (Path(place) / "answers").read_bytes()
