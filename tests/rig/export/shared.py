"""What the tests of the export share."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from copy import copy
from functools import cache, partial
from pathlib import Path
from typing import Any, get_args

import can
import pytest

from can_rig.controllers.ecus import HostEcu
from can_rig.controllers.our_law import PYTHON
from can_rig.controllers.protocol import Supplied
from can_rig.export.application import application, in_precision
from can_rig.export.boards import COMPILER, EMULATOR
from can_rig.export.compiler import WARNINGS, built
from can_rig.export.law import numbers_of, support
from can_rig.export.network_code import NetworkCode
from can_rig.export.trials import random_frames
from can_rig.frames.network import Network
from can_rig.nodes.lockstep import ControllerNode, EcuNode
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import Precision
from tests.helpers import on_a_bus

PRECISIONS: tuple[Precision, ...] = get_args(Precision)
EMULATED = pytest.mark.skipif(
    shutil.which(COMPILER) is None or shutil.which(EMULATOR) is None,
    reason=f"{COMPILER} or {EMULATOR} is not installed",
)
STRICT = ["-std=c99", "-Werror", *WARNINGS, "-Wstrict-prototypes", "-Wcast-qual", "-Wundef"]


def run(*command: str | Path, **options: object) -> str:
    """The standard output of a program that succeeds."""
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, check=False, **options
    )  # type: ignore[call-overload]
    assert done.returncode == 0, done.stderr
    return str(done.stdout)


def log_of(name: str, settings: Sequence[str], controller: Supplied = PYTHON) -> bytes:
    """The log of a run with both nodes in this process."""
    return log_from(load(name, settings), controller)


def log_from(scenario: Scenario, controller: Supplied = PYTHON) -> bytes:
    """The same of a scenario."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "bus.log"
        on_a_bus(scenario, log, controller, "virtual:export")
        return log.read_bytes()


def judged_alike(scenario: Scenario, host: Callable[[], HostEcu], seed: int) -> list[Any]:
    """What the nodes in Python and in C reject of any frames, which they answer alike.

    Of wrong ticks and lengths, repeated, damaged, missing, and of another kind.
    """
    network, sent = network_of(scenario), ([], [])

    def kept(message: can.Message, into: list[object]) -> None:
        kind = (message.arbitration_id, message.is_extended_id, message.is_fd)
        into.append((*kind, bytes(message.data)))

    nodes = (
        ControllerNode(scenario, network, partial(kept, into=sent[0]), PYTHON),
        EcuNode(scenario, network, partial(kept, into=sent[1]), host()),
    )
    for message in (each for tick in random_frames(network, seed) for each in tick):
        other = copy(message)
        other.is_extended_id ^= True
        for frame in (other, message):
            one, two = (node.take(frame) for node in nodes)
            assert one == two
    assert sent[0] == sent[1]
    assert sent[0]
    return [node.rejected() for node in nodes]


FRAMES_DRIVER = """
#include "ecu.h"
static const struct frame *const frames[] = {&frame_reference, &frame_feedback, &frame_command_1,
                                             &frame_command_2, &frame_status};
void pack(int n, double value, uint32_t tick, uint32_t code, uint8_t *data)
{
    const struct frame_content content = {(real)value, tick, code & 3, code >> 2 & 3, code >> 4};
    frames[n]->pack(frames[n], &content, data);
}
double unpack(int n, const uint8_t *data, uint32_t *tick)
{
    struct frame_content content = {0};
    frames[n]->unpack(frames[n], data, &content);
    *tick = content.tick;
    return (double)content.value;
}
"""


@cache
def _headers(precision: Precision) -> dict[str, str]:
    node = application(in_precision(load("default", []), precision))
    return {name: text for name, text in node.items() if name.endswith(".h")}


def frames_in_c(network: Network, precision: Precision) -> ctypes.CDLL:
    """``pack`` and ``unpack`` of the frames of ``network``, by their place in it."""
    code = NetworkCode(in_precision(load("default", []), precision), network)
    words = {**numbers_of(precision), **code.texts}
    files = {name: support(name, code.parts, **words) for name in ("frames.h", "frames.c")}
    files = {**_headers(precision), **files, "network.c": code.source(), "code.c": FRAMES_DRIVER}
    library = ctypes.CDLL(
        str(built(["gcc"], ("-O1", "-std=c99", "-shared", "-fPIC"), files, ".so"))
    )
    library.pack.argtypes = [
        ctypes.c_int, ctypes.c_double, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_void_p,
    ]  # fmt: skip
    library.unpack.restype = ctypes.c_double
    return library
