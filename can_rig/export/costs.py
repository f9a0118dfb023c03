"""The costs of the exported controller: memory and instructions on emulated boards.

Instructions are counted on the inputs of the scenario itself, in Python's run of it; where designs
are blended by the speed, a tick takes in the speed of the scenario's drive before its step. Sizes
come from compiled objects. The stack is the deepest chain of calls, by the compiler's stack usage
of each function.
"""

import re
import tempfile
from collections import Counter
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from can_rig.export.boards import BOARDS, COMPILER, FLAGS, emulated, image_of
from can_rig.export.compiler import placed, run, shared_library
from can_rig.export.law import CHANGE_SPEED, law_program, speed_program, support
from can_rig.export.network_code import frame_bytes
from can_rig.export.subset import Program
from can_rig.frames.codec import FRAME_BYTES, Transmitter
from can_rig.frames.network import Network
from firmware_model.law.structs import FloatArray, Precision

BOARDS_OF: Final[dict[Precision, tuple[str, ...]]] = {"float32": ("m4f", "m7"), "float64": ("m7",)}
"""The boards whose floating-point unit has the precision."""
NS_PER_INSTRUCTION, NS_PER_COUNT = 64, 40  # of ``board_count.c``
MOST_TICKS: Final = 65536
KEPT: Final = "kept.c"
SIZE, ADDR2LINE = (COMPILER.replace("gcc", tool) for tool in ("size", "addr2line"))
NO_LAW: Final = (
    "network.c", "crc.c", "e2e.c", "ecu.c", "frames.c", "self_test.c",
    "self_test_data.c",
)  # fmt: skip


def law_of(node: Mapping[str, str]) -> dict[str, str]:
    """The law and its constants, of the files of a whole node."""
    return {name: text for name, text in node.items() if name not in NO_LAW}


def instructions(
    files: Mapping[str, str], board: str, inputs: FloatArray, network: Network | None = None
) -> FloatArray:
    """How many each tick takes, shape (ticks,): of the law, or of the node in ``files``.

    Args:
        files: text by file name.
        board: a key of ``BOARDS``.
        inputs: reference, measurement and, with a drive, speed of each tick.
        network: the frames of a node; None: ``files`` are the law alone.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    image = image_of(files, "board_count.c", board)
    given = _file_of(inputs) if network is None else _frames_of(inputs, network)
    counted = emulated(image, board, given, "counts", "-icount", "shift=6,sleep=off")
    return np.asarray(np.frombuffer(counted, "<u4") * (NS_PER_COUNT / NS_PER_INSTRUCTION))


def _file_of(inputs: FloatArray) -> dict[str, bytes]:
    """What `support/board_count.c` reads: the first ``MOST_TICKS`` inputs."""
    inputs = inputs[:MOST_TICKS]
    return {"inputs": len(inputs).to_bytes(4, "little") + inputs.astype("<f8").tobytes()}


def _frames_of(inputs: FloatArray, network: Network) -> dict[str, bytes]:
    """The same in frames, each in the room of the longest: fewer ticks if that is long."""
    room = frame_bytes(network)
    inputs = inputs[: MOST_TICKS * FRAME_BYTES // room]
    senders = (network.reference, network.feedback, *([network.speed] if network.speed else []))
    transmitters = [Transmitter(codec) for codec in senders]
    frames = (
        bytes(transmitter.frame(value, tick).data).ljust(room, b"\0")
        for tick, values in enumerate(inputs.tolist())
        for transmitter, value in zip(transmitters, values, strict=True)
    )
    return {"inputs": len(inputs).to_bytes(4, "little") + b"".join(frames)}


def instructions_by_file(
    files: Mapping[str, str], board: str, inputs: FloatArray
) -> dict[str, float]:
    """Instructions a tick of the law in each source file, the largest first.

    A plugin of QEMU counts every instruction; its line comes from the debugging information, so an
    inlined function counts in its own file. What start-up and reading take is subtracted.

    Args:
        files: the law and its constants, text by file name.
        board: a key of ``BOARDS``.
        inputs: of ``instructions``.

    Raises:
        ExportError: a tool is missing, or refuses.
    """
    image = image_of(files, "board_count.c", board)
    plugin = shared_library({"count_blocks.c": support("count_blocks.c")})
    counts: Counter[str] = Counter()
    for given, sign in ((inputs, 1), (inputs[:0], -1)):
        said = emulated(image, board, _file_of(given), "blocks", "-plugin", f"file={plugin}")
        for line in said.decode().splitlines():
            count, *addresses = line.split()
            for address in addresses:
                counts[address] += sign * int(count)
    lines = run([ADDR2LINE, "-e", str(image), *counts], image.parent).splitlines()
    found: Counter[str] = Counter()
    for place, times in zip(lines, counts.values(), strict=True):
        found[Path(place.partition(":")[0]).name] += times
    ticks = min(len(inputs), MOST_TICKS)
    outside = ("board_count.c", "startup.c", "host.c")
    return {name: n / ticks for name, n in found.most_common() if n > 0 and name not in outside}


def sizes(files: Mapping[str, str], board: str) -> dict[str, int]:
    """What the law takes in a board's memory; the state includes a blended table, if any.

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
    code = sum(found.values())
    return {
        "code_bytes": code, "constant_bytes": constants, "state_bytes": state, "stack_bytes": stack,
    }  # fmt: skip


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
