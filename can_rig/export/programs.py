"""Programs that run a law on random memory, and random frames for a controller node."""

from __future__ import annotations

import math
import random
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import can

from can_rig.errors import ExportError
from can_rig.export.boards import (
    COUNT,
    LONGEST_S,
    RESTART,
    emulated,
    frame_order,
    image_of,
    time_order,
)
from can_rig.export.compiler import built
from can_rig.export.law import parts_of, support
from can_rig.frames.endpoints import Transmitter
from can_rig.frames.network import Network

HOST_FLAGS: Final = ("-std=c99", "-ffp-contract=off")

TICKS = 60
VALUES = (-2.0, 2.0)
SPEEDS = (-5.0, 50.0)  # m/s: within the designs' range and outside
LAST_TICKS = 65530  # the 16 bits of the tick end soon


def random_frames(network: Network, seed: int) -> list[list[can.Message]]:
    """By tick, what the plant node might have sent, the same for the same ``seed``."""
    choose, ticks = random.Random(seed), []
    transmitters = [Transmitter(codec) for codec in network.inputs]
    first = choose.choice([0, LAST_TICKS])
    for tick in range(first, first + TICKS):
        frames: list[can.Message] = []
        for transmitter in transmitters:
            if choose.random() < 0.03:  # lose a few frames in a row
                for _ in range(choose.randrange(1, 9)):
                    transmitter.frame(0.0, tick)
            size = choose.choice([1.0, 1.0, 1.0, 1.0, 1e3, math.inf, math.nan])
            ends = SPEEDS if transmitter.codec is network.speed else VALUES
            message = transmitter.frame(size * choose.uniform(*ends), tick)
            what = choose.random()
            if what < 0.04:
                continue
            if what < 0.08:
                message.data[choose.randrange(8)] ^= 1 << choose.randrange(8)
            if what > 0.97:
                message.data = message.data[: choose.randrange(8)]
            frames += [message] * choose.choice([1, 1, 1, 1, 2])
        ticks.append(frames)
    return ticks


def as_orders(network: Network, seeds: range, tick_us: int) -> bytes:
    """Random frames with clock times, as orders of `support/bench.h`.

    Each seed has its own start time.

    The clock wraps; the node reads the clock before and after half a tick.
    """
    orders = []
    for seed in seeds:
        choose, at_us = random.Random(seed), 2**32 - TICKS // 2 * tick_us
        orders.append(RESTART)
        for frames in random_frames(network, seed):
            late_us = choose.choice([0, choose.randrange(-tick_us // 20, tick_us // 20)])
            orders.append(time_order(at_us + late_us))
            for message in frames:
                orders.append(frame_order(message.arbitration_id, bytes(message.data)))
            orders += [time_order(at_us + tick_us * tenth // 10) for tenth in (4, 5, 6)]
            at_us += tick_us
        orders.append(COUNT)
    return b"".join(orders)


def trial_files(law: Mapping[str, str]) -> dict[str, str]:
    """The files of the law, and the trial that runs the law on any memory.

    The caller adds ``main``.

    Args:
        law: text by file name; `schedule.c` enables changes of speed.
    """
    return {**law, **{name: support(name, parts_of(law)) for name in ("bench.h", "trial.c")}}


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
    return emulated(image, board, {"orders": orders}, "answers")
