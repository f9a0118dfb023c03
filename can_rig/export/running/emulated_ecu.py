"""The whole controller node in C on a Cortex-M that QEMU emulates."""

from __future__ import annotations

import os
import select
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from can_rig.errors import ExportError
from can_rig.export.application import application
from can_rig.export.law import filled, support
from can_rig.export.running.compiler import built
from can_rig.export.running.ecu import bench
from can_rig.export.speed_words import words_of
from can_rig.scenario.settings import Scenario

COMPILER: Final = "arm-none-eabi-gcc"
EMULATOR: Final = "qemu-system-arm"
DEBIAN: Final = "apt install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"


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
    "-ffunction-sections", "-fno-math-errno",
)  # fmt: skip
LINKED: Final = ("-nostartfiles", "-Wl,--gc-sections", "-Tmps2.ld")

LOOK_S: Final = 0.5
MOST_WAITING: Final = 1 << 12


def require_tools() -> None:
    """Refuse where the compiler or the emulator is missing.

    Raises:
        ExportError: a tool is missing.
    """
    for tool in (COMPILER, EMULATOR):
        if shutil.which(tool) is None:
            raise ExportError(f"{tool} is not installed; it must be (Debian: {DEBIAN})")


def firmware_image(scenario: Scenario, board: str) -> Path:
    """The controller node of ``scenario`` as a program for ``board``, a key of ``BOARDS``.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    files = application(scenario)
    return image_of(files | bench(files), "board_ecu.c", board)


def image_of(files: Mapping[str, str], program: str, board: str) -> Path:
    """A program for ``board`` from ``files`` and ``program``, the source of ``main``.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    require_tools()
    around = {name: support(name) for name in (program, "host.h", "host.c", "startup.c", "mps2.ld")}
    zero = "0.0f" if "typedef float real;" in files["real.h"] else "0.0"
    around[program] = filled(around[program], zero=zero, **words_of(files))
    return built([COMPILER], (*FLAGS, *BOARDS[board].flags, *LINKED), {**files, **around}, ".elf")


def emulation(image: Path, board: str, *options: str) -> list[str]:
    """The command that runs ``image`` on ``board``."""
    return [
        EMULATOR, "-machine", BOARDS[board].machine, "-nographic", "-monitor", "none",
        "-serial", "none", "-semihosting-config", "enable=on,target=native", *options,
        "-kernel", str(image),
    ]  # fmt: skip


class EmulatedBoard:
    """A program of ``firmware_image`` on its board, by two named pipes; see ``Link``.

    Args:
        image: the program.
        board: a key of ``BOARDS``.

    Raises:
        ExportError: the emulator does not start.
    """

    def __init__(self, image: Path, board: str) -> None:
        self._folder = tempfile.mkdtemp(prefix="can-rig-")
        for pipe in ("orders", "answers"):
            os.mkfifo(Path(self._folder) / pipe)
        self._process = subprocess.Popen(
            emulation(image, board),
            cwd=self._folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        # Open for both directions: opening then never waits for the other side.
        self._orders = os.open(Path(self._folder) / "orders", os.O_RDWR)
        self._answers = os.open(Path(self._folder) / "answers", os.O_RDWR | os.O_NONBLOCK)
        self._waiting = b""

    def write(self, data: bytes) -> None:
        """See ``Link``."""
        os.write(self._orders, data)

    def read(self, size: int) -> bytes:
        """See ``Link``; looks now and then whether the emulator still runs."""
        while len(self._waiting) < size:
            ready, _, _ = select.select([self._answers], [], [], LOOK_S)
            if ready:
                self._waiting += os.read(self._answers, MOST_WAITING)
            elif self._process.poll() is not None:
                assert self._process.stderr is not None
                said = self._process.stderr.read().decode(errors="replace").strip()
                raise ExportError(f"{EMULATOR} has ended: {said or self._process.returncode}")
        answer, self._waiting = self._waiting[:size], self._waiting[size:]
        return answer

    def close(self) -> None:
        """See ``Link``."""
        for pipe in (self._orders, self._answers):
            os.close(pipe)
        self._process.kill()
        self._process.communicate()
        shutil.rmtree(self._folder, ignore_errors=True)
