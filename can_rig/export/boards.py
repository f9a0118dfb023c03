"""Programs for a Cortex-M board, and QEMU that emulates the board.

Boards answer a bench over a link of bytes: ``support/bench.h`` says how.
"""

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from can_rig.errors import ExportError
from can_rig.export.application import ORDER_HEAD, application, bench
from can_rig.export.compiler import built
from can_rig.export.law import numbers_of, parts_of, support
from can_rig.scenario.settings import Scenario

RESTART, SURVIVE, COUNT = b"R", b"R\x01", b"C"
"""Orders of the bench, which ``order`` makes as long as any."""


def order(begin: bytes, room: int) -> bytes:
    """An order to a node whose longest frame has ``room`` bytes."""
    return begin.ljust(ORDER_HEAD + room, b"\0")


def frame_order(frame_id: int, data: bytes, room: int) -> bytes:
    """The order to take a frame; the node reads no byte beyond ``room``."""
    said = b"F" + frame_id.to_bytes(4, "little") + bytes([len(data)]) + data[:room]
    return order(said, room)


def time_order(now_us: int, room: int) -> bytes:
    """The order that sets the clock, modulo 2^32."""
    return order(b"T" + (now_us & 0xFFFFFFFF).to_bytes(4, "little"), room)


COMPILER: Final = "arm-none-eabi-gcc"
EMULATOR: Final = "qemu-system-arm"
DEBIAN: Final = "apt install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
LONGEST_S: Final = 600.0


@dataclass(frozen=True)
class Board:
    """A microcontroller: the emulated machine, and its compiler options."""

    machine: str
    flags: tuple[str, ...]


BOARDS: Final = {
    "m4f": Board("mps2-an386", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16")),
    "m7": Board("mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16")),
}
FLAGS: Final = (
    "-std=c99", "-O2", "-ffp-contract=off", "-mthumb", "-mfloat-abi=hard", "-fdata-sections",
    "-ffunction-sections", "-fno-math-errno", "-g",
)  # fmt: skip
LINKED: Final = ("-nostartfiles", "-Wl,--gc-sections", "-Tmps2.ld")


def firmware_image(scenario: Scenario, board: str) -> Path:
    """The controller node of ``scenario`` as a program for ``board``, a key of ``BOARDS``.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    node = application(scenario)
    return image_of(node | bench(node), "board_ecu.c", board)


def image_of(files: Mapping[str, str], program: str | None, board: str) -> Path:
    """A program for ``board`` from ``files`` and ``program``, the source of ``main``.

    None: ``files`` have a ``main``.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    for tool in (COMPILER, EMULATOR):
        if shutil.which(tool) is None:
            raise ExportError(f"{tool} is not installed; it must be (Debian: {DEBIAN})")
    single = "typedef float real;" in files["real.h"]
    numbers = numbers_of("float32" if single else "float64")
    added = (program, "host.h", "host.c", "startup.c", "mps2.ld")
    around = {name: support(name, parts_of(files), **numbers) for name in added if name}
    return built([COMPILER], (*FLAGS, *BOARDS[board].flags, *LINKED), {**files, **around}, ".elf")


def emulation(image: Path, board: str, *options: str) -> list[str]:
    """The command that runs ``image`` on ``board``."""
    return [
        EMULATOR, "-machine", BOARDS[board].machine, "-nographic", "-monitor", "none",
        "-serial", "none", "-semihosting-config", "enable=on,target=native", *options,
        "-kernel", str(image),
    ]  # fmt: skip


def emulated(
    image: Path, board: str, inputs: Mapping[str, bytes], output: str, *options: str
) -> bytes:
    """A file that ``image`` writes on ``board`` until it ends.

    Args:
        image: a program of ``image_of``.
        board: a key of ``BOARDS``.
        inputs: the files that the program reads, by name.
        output: the name of the file.
        options: of the emulator.

    Raises:
        ExportError: the emulator fails, or does not end.
    """
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        for name, data in inputs.items():
            (Path(place) / name).write_bytes(data)
        command = emulation(image, board, *options)
        try:
            subprocess.run(command, cwd=place, capture_output=True, check=True, timeout=LONGEST_S)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
            raise ExportError(f"the emulator did not end: {error}") from None
        return (Path(place) / output).read_bytes()
