"""Rates of decoding a log, ours beside python-can with cantools, and beside asammdf.

All in one process and in CPU time, interleaved, medians. The log is a
run of the rig, repeated, in which every frame passes the checks; or
frames with random bytes, of all messages of a database in turn.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import asammdf
import can
import numpy as np
from asammdf.blocks.utils import load_can_database
from cantools.database import DecodeError
from cantools.database.can import Database, Message
from rich.console import Console
from rich.table import Table

from can_rig.cli.output import counting
from can_rig.controllers.our_law import PYTHON
from can_rig.decoding.decode import decode_log
from can_rig.frames.databases import load_database, shipped_dbc
from can_rig.logs.formats.candump import candump_lines
from can_rig.logs.frames import CLASSIC_BYTES, concatenate
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from can_rig.scenario.loading import load

PAYLOADS = 16  # of each message
TRIES = 100 * PAYLOADS  # for those payloads
RUN_S = 15.0  # whole cycles of the alive counter, so that a repetition loses no frame


def repeated_run(folder: Path, frames: int) -> Path:
    """A candump log of at least so many frames: a run, over and over."""
    scenario = load("thesis-step", [f"duration_s={RUN_S}"])
    once = folder / "once.log"
    run_in_process(scenario, "virtual:bench", once, StopRequest(), lambda _ticks: None, PYTHON)
    run = concatenate(read_log(once))
    path = folder / "bench.log"
    with path.open("w", encoding="ascii") as file:
        for repetition in range(-(-frames // len(run))):
            later = replace(run, time_ns=run.time_ns + repetition * round(RUN_S * 1e9))
            file.writelines(candump_lines(later))
    return path


def random_log(folder: Path, frames: int, database: Database) -> Path:
    """A candump log of at least so many frames, every 0.1 ms the next message of the database."""
    chosen = [(message, payloads(message)) for message in database.messages]
    chosen = [(message, made) for message, made in chosen if made]
    if not chosen:
        raise SystemExit("cantools reads no frame of this database")
    turn = [(message, made[k % len(made)]) for k in range(PAYLOADS) for message, made in chosen]
    path = folder / "bench.log"
    with can.Logger(path) as log:
        for number, (message, data) in enumerate(turn * -(-frames // len(turn))):
            log(can.Message(
                timestamp=1e-4 * number, arbitration_id=message.frame_id, data=data,
                is_extended_id=message.is_extended_frame, is_fd=len(data) > CLASSIC_BYTES,
            ))  # fmt: skip
    return path


def payloads(message: Message) -> list[bytes]:
    """Random bytes that cantools decodes: not every multiplexer value has signals."""
    made: list[bytes] = []
    random = np.random.default_rng(message.frame_id)
    for _ in range(TRIES):
        data = random.bytes(message.length)
        with suppress(DecodeError):
            message.decode(data, decode_choices=False)
            made.append(data)
        if len(made) == PAYLOADS:
            break
    return made


def by_python_can_and_cantools(path: Path, database: Database) -> dict[str, np.ndarray]:
    """Columns frame by frame, as most scripts do it; nothing is checked."""
    columns: dict[str, list[Any]] = {}
    with can.LogReader(path) as reader:
        for message in reader:
            values: Any = database.decode_message(
                message.arbitration_id, bytes(message.data), decode_choices=False
            )
            for name, value in values.items():
                columns.setdefault(f"{message.arbitration_id}.{name}", []).append(value)
    return {name: np.array(column) for name, column in columns.items()}


def ours(path: Path, database: Database) -> None:
    """Columns, with every CRC and counter checked."""
    log = decode_log(path, database)
    bad = {name: c for name, c in log.counts.items() if c.decoded != c.frames}
    if bad or log.unknown or not any(c.frames for c in log.counts.values()):
        raise SystemExit(f"not every frame was decoded: {bad} {log.unknown}")


def by_asammdf(path: Path, matrix: object) -> None:
    """What asammdf makes of the same MDF file."""
    with asammdf.MDF(path) as file, file.extract_bus_logging({"CAN": [(matrix, 0)]}) as extracted:
        if not extracted.groups:
            raise SystemExit("asammdf found no signals")


def seconds(action: Callable[[], object]) -> float:
    """CPU time of a single call [s]; other programs on the machine count little."""
    start = time.process_time()
    action()
    return time.process_time() - start


def bench_decode(frames: int, rounds: int, dbc: Path | None) -> None:
    """Print the table; ``dbc`` None: of the rig's own frames."""
    if dbc is None:
        database = load_database(shipped_dbc("steer_by_wire.dbc"))
    else:
        database = load_database(dbc, strict=False)
    matrix = load_can_database(dbc or shipped_dbc("steer_by_wire.dbc"))
    with tempfile.TemporaryDirectory() as name:
        if dbc is None:
            candump = repeated_run(Path(name), frames)
        else:
            candump = random_log(Path(name), frames, database)
        log = concatenate(read_log(candump))
        pairs: dict[str, tuple[str, Callable[[], object], Callable[[], object]]] = {}
        for suffix in (".log", ".asc", ".blf", ".trc", ".mf4"):
            path = candump.with_suffix(suffix)
            if path != candump:
                write_log(read_log(candump), path)
            ours(path, database)  # compiles
            other, theirs_once = (
                ("asammdf, extract_bus_logging", partial(by_asammdf, path, matrix))
                if suffix == ".mf4"
                else ("python-can, cantools", partial(by_python_can_and_cantools, path, database))
            )
            pairs[suffix] = other, theirs_once, partial(ours, path, database)
        timings: dict[str, list[tuple[float, float]]] = {suffix: [] for suffix in pairs}
        with counting("measuring", "logs", rounds * len(pairs)) as measured:
            for done in range(rounds):
                for nth, (suffix, (_, theirs, mine)) in enumerate(pairs.items()):
                    measured(done * len(pairs) + nth)
                    timings[suffix].append((seconds(theirs), seconds(mine)))
    table = Table("log", "beside", "its frames/s", "can-rig's frames/s", "times", box=None)
    for suffix, taken_s in timings.items():
        rates = [len(log) / statistics.median(column) for column in zip(*taken_s, strict=True)]
        ratio = statistics.median(theirs / mine for theirs, mine in taken_s)
        table.add_row(suffix, pairs[suffix][0], *(f"{r:,.0f}" for r in rates), f"{ratio:.1f}")
    console = Console()
    what = f"{len(log):,} frames of {len(np.unique(log.arbitration_id))} messages"
    console.print(f"{what}, {rounds} rounds, CPU time", highlight=False)
    console.print(table)
