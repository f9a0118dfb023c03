"""What the exported controller costs: memory and instructions on emulated boards.

Instructions are counted on the inputs of the scenario itself, in Python's run of it. A stack is the
deepest chain of calls, each with what the compiler says that it needs.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from can_rig.errors import ExportError
from can_rig.export.application import application
from can_rig.export.folder import in_precision
from can_rig.export.law import law_program
from can_rig.export.running.compiler import run
from can_rig.export.running.emulated_ecu import BOARDS, COMPILER, FLAGS, emulation, image_of
from can_rig.plant.frameless import frameless
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from firmware_model.target.layout import state_type, table_type
from firmware_model.target.structs import FloatArray, Precision

VARIANTS: Final[tuple[tuple[str, Precision], ...]] = (
    ("m4f", "float32"), ("m7", "float32"), ("m7", "float64"), ("m4f", "float64"),
)  # fmt: skip
NS_PER_INSTRUCTION, NS_PER_COUNT = 64, 40  # of ``board_count.c``
MOST_TICKS: Final = 65536
NO_LAW: Final = ("network.c", "constants.c", "e2e.c", "ecu.c", "frames.c")


@dataclass(frozen=True)
class Cost:
    """What the law costs on one board."""

    board: str
    precision: Precision
    code_bytes: int
    constant_bytes: int
    state_bytes: int
    stack_bytes: int
    median: float
    """Instructions a step."""
    worst: float
    worst_tick: int
    """Of the run, in which the worst step is."""


def inputs_of_run(scenario: Scenario) -> FloatArray:
    """Reference and measurement of each tick of the scenario's run, shape (ticks, 2).

    Raises:
        ScenarioError: a scenario that cannot run.
    """
    trace = frameless(scenario, network_of(scenario))
    return np.column_stack([trace.reference, trace.measured])[:MOST_TICKS]


def cost(scenario: Scenario, board: str, precision: Precision, inputs: FloatArray) -> Cost:
    """The cost of a scenario's law.

    Args:
        scenario: whose controller it is.
        board: a key of ``BOARDS``.
        precision: of its real numbers.
        inputs: reference and measurement of each tick, shape (ticks, 2).

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    files = application(in_precision(scenario, precision))
    law = {name: text for name, text in files.items() if name not in NO_LAW}
    counts = instructions({**law, "constants.c": files["constants.c"]}, board, inputs)
    worst = int(np.argmax(counts))
    code, stack = _code_and_stack(law, board)
    return Cost(
        board,
        precision,
        code,
        table_type(precision).itemsize,
        state_type(precision).itemsize,
        stack,
        float(np.median(counts)),
        float(counts[worst]),
        worst,
    )


def instructions(files: Mapping[str, str], board: str, inputs: FloatArray) -> FloatArray:
    """How many each step takes, shape (ticks,).

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    image = image_of(files, "board_count.c", board)
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        ticks = len(inputs).to_bytes(4, "little")
        (Path(place) / "inputs").write_bytes(ticks + inputs.astype("<f8").tobytes())
        command = emulation(image, board, "-icount", "shift=6,sleep=off")
        try:
            subprocess.run(command, cwd=place, capture_output=True, check=True, timeout=600)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
            raise ExportError(f"the emulator did not count: {error}") from None
        counted = np.fromfile(Path(place) / "counts", "<u4")
    return np.asarray(counted * (NS_PER_COUNT / NS_PER_INSTRUCTION))


def _code_and_stack(files: Mapping[str, str], board: str) -> tuple[int, int]:
    """Bytes of code, and of stack at the deepest."""
    flags = [*FLAGS, *BOARDS[board].flags, "-fstack-usage", "-c"]
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        folder = Path(place)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        units = [name for name in files if name.endswith(".c")]
        run([COMPILER, *flags, *units], folder)
        sizes = run([COMPILER.replace("gcc", "size"), *(f"{u[:-2]}.o" for u in units)], folder)
        own: dict[str, int] = {}
        for path in folder.glob("*.su"):
            found = re.findall(r":(\w+)\t(\d+)\t", path.read_text(encoding="utf-8"))
            own |= {function: int(size) for function, size in found}
    code = sum(int(line.split()[0]) for line in sizes.splitlines()[1:])
    law = law_program().functions

    @cache
    def deepest(function: str) -> int:
        """Stack of a function and of what it calls; what was inlined has none of its own."""
        below = {callee.function.c_name for callee in law[function].calls.values()}
        return own.get(function, 0) + max(map(deepest, below), default=0)

    return code, own.get("firmware_step", 0) + deepest("controller_step")
