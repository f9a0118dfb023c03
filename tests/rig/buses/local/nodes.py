"""What the tests of the local bus share: nodes here and in processes, numbered frames."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can

from can_rig.buses.local.bus import LocalBus

TIMEOUT_S = 30.0  # for what must come
NODE = """
import sys, can
from can_rig.buses.local.bus import LocalBus
bus = LocalBus("x")
print("ready", flush=True)
"""


@contextlib.contextmanager
def buses(*options: dict[str, Any]) -> Iterator[list[LocalBus]]:
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(LocalBus("x", **each)) for each in options]


@contextlib.contextmanager
def node(program: str) -> Iterator[subprocess.Popen[str]]:
    """Another process on the bus; it is there when the block begins, and gone when it ends."""
    command = [sys.executable, "-u", "-c", NODE + program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def frame(number: int, **kwargs: Any) -> can.Message:
    data = number.to_bytes(4, "little")
    return can.Message(arbitration_id=0x100, is_extended_id=False, data=data, **kwargs)


def number(msg: can.Message | None) -> int:
    assert msg is not None
    return int.from_bytes(msg.data, "little")


def sockets(root: Path) -> list[Path]:
    return sorted(root.glob("x/*.node"))
