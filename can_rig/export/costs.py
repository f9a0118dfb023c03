"""The costs of the exported controller: memory and instructions on emulated boards.

Instructions are counted on the inputs of the scenario itself, in Python's run of it; where designs
are blended by the speed, a tick takes in the speed of the scenario's drive before its step. Sizes
come from compiled objects. The stack is the deepest chain of calls, by the compiler's stack usage
of each function.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from can_rig.export.application import application, in_precision
from can_rig.export.boards import BOARDS, COMPILER, FLAGS, emulated, image_of
from can_rig.export.compiler import placed, run
from can_rig.export.law import CHANGE_SPEED, law_program, speed_program
from can_rig.export.subset import Program
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import FloatArray, Precision

VARIANTS: Final[tuple[tuple[str, Precision], ...]] = (
    ("m4f", "float32"), ("m7", "float32"), ("m7", "float64"), ("m4f", "float64"),
)  # fmt: skip
NS_PER_INSTRUCTION, NS_PER_COUNT = 64, 40  # of ``board_count.c``
MOST_TICKS: Final = 65536
KEPT: Final = "kept.c"
SIZE: Final = COMPILER.replace("gcc", "size")
NO_LAW: Final = (
    "network.c", "constants.c", "crc.c", "e2e.c", "ecu.c", "frames.c", "self_test.c",
    "self_test_data.c",
)  # fmt: skip


@dataclass(frozen=True)
class Cost:
    """The cost of the law on a board."""

    board: str
    precision: Precision
    code_bytes: int
    constant_bytes: int
    state_bytes: int
    """Memory kept by an application: the state, and the blended table, if any."""
    stack_bytes: int
    counts: FloatArray | None
    """Instructions of each tick, shape (ticks,); None: not counted."""
    node_counts: FloatArray | None
    """Likewise of the whole node, from frames to frames."""

    @property
    def median(self) -> float:
        """Instructions a tick."""
        assert self.counts is not None
        return float(np.median(self.counts))

    @property
    def node_median(self) -> float:
        """Instructions of the whole node a tick."""
        assert self.node_counts is not None
        return float(np.median(self.node_counts))

    @property
    def worst(self) -> float:
        """The most instructions of a tick."""
        assert self.counts is not None
        return float(self.counts.max())

    @property
    def worst_tick(self) -> int:
        """The tick of ``worst``."""
        assert self.counts is not None
        return int(np.argmax(self.counts))


def cost(scenario: Scenario, board: str, precision: Precision, inputs: FloatArray | None) -> Cost:
    """The cost of a scenario's law.

    Args:
        scenario: the scenario.
        board: a key of ``BOARDS``.
        precision: of its real numbers.
        inputs: from ``frameless.controller_inputs``, the first ``MOST_TICKS`` of them count; None:
            sizes only, without an emulator.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    files = application(in_precision(scenario, precision))
    law = {name: text for name, text in files.items() if name not in NO_LAW}
    law["constants.c"] = files["constants.c"]
    counts, of_node = (
        None if inputs is None else instructions(each, board, inputs) for each in (law, files)
    )
    return Cost(board, precision, *sizes(law, board), counts, of_node)


def instructions(files: Mapping[str, str], board: str, inputs: FloatArray) -> FloatArray:
    """How many each tick takes, shape (ticks,): of the law, or of the node in ``files``.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    inputs = inputs[:MOST_TICKS]
    image = image_of(files, "board_count.c", board)
    data = {"inputs": len(inputs).to_bytes(4, "little") + inputs.astype("<f8").tobytes()}
    counted = emulated(image, board, data, "counts", "-icount", "shift=6,sleep=off")
    return np.asarray(np.frombuffer(counted, "<u4") * (NS_PER_COUNT / NS_PER_INSTRUCTION))


def sizes(files: Mapping[str, str], board: str) -> tuple[int, int, int, int]:
    """Bytes of code, constants, kept memory and stack.

    Args:
        files: the law and its constants, text by file name.
        board: a key of ``BOARDS``.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    memory = "firmware_memory" if "schedule.c" in files else "layout_state"
    kept = f'#include "firmware.h"\nstruct {memory} kept;\n'
    flags = [*FLAGS, *BOARDS[board].flags, "-fstack-usage", "-c"]
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        folder = Path(place)
        units = placed(folder, {**files, KEPT: kept})
        run([COMPILER, *flags, *units], folder)
        said = run([SIZE, *(f"{unit[:-2]}.o" for unit in units)], folder).splitlines()[1:]
        stack = _stack(folder, blends="schedule.c" in files)
    found = {unit: sum(map(int, line.split()[:3])) for unit, line in zip(units, said, strict=True)}
    constants, state = found.pop("constants.c"), found.pop(KEPT)
    return sum(found.values()), constants, state, stack


def _stack(folder: Path, blends: bool) -> int:
    """Bytes at the deepest in a tick: of the step, or of the change of the speed before it."""
    own: dict[str, int] = {}
    for path in folder.glob("*.su"):
        said = path.read_text(encoding="utf-8")
        for function, size in re.findall(r":(\w+)[\w.]*\t(\d+)\t", said):  # clones too
            own[function] = max(own.get(function, 0), int(size))

    def from_(entry: str, program: Program, called: str) -> int:
        @cache
        def deepest(function: str) -> int:
            """Stack of a function and its callees; inlined functions have no entry."""
            calls = program.functions[function].calls.values()
            below = {callee.function.c_name for callee in calls}
            return own.get(function, 0) + max(map(deepest, below), default=0)

        return own.get(entry, 0) + deepest(called)

    step = from_("firmware_step", law_program(), "controller_step")
    if not blends:
        return step
    change = from_(f"firmware_{CHANGE_SPEED}", speed_program(), f"schedule_{CHANGE_SPEED}")
    return max(step, change)
