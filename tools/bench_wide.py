"""A log of random frames through a wide database, into files: ours beside what a script does.

The script decodes with python-can and cantools, and writes one Parquet file a message with pandas.
Each runs as a process of its own, start and imports included; interleaved, medians of CPU time.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from cantools.database.can import Database
from rich.console import Console
from rich.table import Table

from can_rig.frames.databases import load_database

_SCRIPT = """
import sys, can, cantools, pathlib, pandas
log, dbc, out = sys.argv[1:]
database = cantools.database.load_file(dbc, strict=False)
rows = {}
with can.LogReader(log) as frames:
    for frame in frames:
        message = database.get_message_by_frame_id(frame.arbitration_id)
        try:
            values = message.decode(frame.data, decode_choices=False)
        except (cantools.database.DecodeError, KeyError):
            continue  # a multiplexer with a value that the database does not have
        rows.setdefault(message.name, []).append({"time": frame.timestamp, **values})
folder = pathlib.Path(out)
folder.mkdir()
for name, values in rows.items():
    pandas.DataFrame(values).to_parquet(folder / f"{name}.parquet")
"""
_MEASURED = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(process.pid, 0)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""A new process counts the memory of its parent as its own: so the parent is a small one."""

_US_A_FRAME = 250


class Cost(NamedTuple):
    """What a process took."""

    cpu_s: float
    peak_mb: float


def made_up(path: Path) -> Path:
    """A database of 145 messages with 10 signals each."""
    lines = ['VERSION ""', "BU_: A"]
    for message in range(145):
        lines.append(f"BO_ {256 + message} M{message}: 8 A")
        lines += [
            f' SG_ S{at} : {at * 6}|6@1+ ({1 if at % 2 else 0.1},0) [0|0] "" A' for at in range(10)
        ]
    path.write_text("\n".join(lines) + "\n", "ascii")
    return path


def random_frames(database: Database, count: int, path: Path) -> None:
    """A candump log of random frames of every message of up to 8 bytes."""
    random = np.random.default_rng(1)
    messages = [message for message in database.messages if 0 < message.length <= 8]
    with path.open("w", encoding="ascii") as file:
        for at, which in enumerate(random.integers(0, len(messages), count)):
            message = messages[which]
            digits = 8 if message.is_extended_frame else 3
            seconds, rest_us = divmod(at * _US_A_FRAME, 1_000_000)
            payload = random.bytes(message.length).hex()
            file.write(
                f"({1_700_000_000 + seconds}.{rest_us:06d}) can0 "
                f"{message.frame_id:0{digits}X}#{payload}\n"
            )


def cost(words: list[str], out: Path) -> Cost:
    """Return the cost of a process that writes ``out``; removes ``out``."""
    small = [sys.executable, "-c", _MEASURED, *words]
    said = subprocess.run(small, stdout=subprocess.PIPE, text=True, check=True).stdout
    if out.is_dir():
        shutil.rmtree(out)
    else:
        out.unlink()
    return Cost(*map(float, said.split()))


def bench_wide(dbc: Path | None, frames: int, rounds: int) -> None:
    """Print the table of one database; None: `made_up`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = dbc or made_up(folder / "made-up.dbc")
        database = load_database(path, strict=False)
        log = folder / "wide.log"
        random_frames(database, frames, log)
        ways = {
            "python-can, cantools, pandas: Parquet a message": (
                [sys.executable, "-c", _SCRIPT, str(log), str(path), str(folder / "theirs")],
                folder / "theirs",
            )
        }
        for label, out in (
            ("Parquet a message", folder / "a.parquet"),
            ("CSV a message", folder / "a"),
            ("one CSV", folder / "a.csv"),
        ):
            words = ["decode", str(log), "--dbc", str(path), "--no-strict", "--out", str(out)]
            ways[f"can-rig decode: {label}"] = [sys.executable, "-m", "can_rig", *words], out
        costs: dict[str, list[Cost]] = {label: [] for label in ways}
        for _ in range(rounds):
            for label, (words, out) in ways.items():
                costs[label].append(cost(words, out))
    signals = sum(len(message.signals) for message in database.messages)
    table = Table("", "CPU time [s]", "times", "most memory [MB]", box=None)
    theirs = next(iter(costs.values()))
    for label, taken in costs.items():
        ratio = statistics.median(a.cpu_s / b.cpu_s for a, b in zip(theirs, taken, strict=True))
        cpu_s, peak_mb = (statistics.median(column) for column in zip(*taken, strict=True))
        table.add_row(label, f"{cpu_s:.2f}", f"{ratio:.1f}", f"{peak_mb:.0f}")
    console = Console()
    console.print(
        f"\n{path.name}: {frames:,} frames, {len(database.messages)} messages, "
        f"{signals:,} signals, {rounds} rounds",
        highlight=False,
    )
    console.print(table)
