"""Runs of two processes as tests see them from outside: their log, their nodes, their folder."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import can

from can_rig.logs.columns import EVIDENCE, VERDICT
from tests.helpers import start
from tests.processes import wait_for

FILES = ["bus.log", "bus.plant.csv", "report.html", "report.png", "run.json", "signals.csv"]
HEADER = (
    "time_s,reference_mps2,dstar_mps2,error_mps2,torque_nm,force_difference_n,"
    "fault_estimate_mps2,mode"
)
REPORTED = (
    "true_dstar_mps2,side_slip_rad,yaw_rate_rad_per_s,steering_angle_rad,applied_torque_nm,"
    "applied_force_difference_n"
)
LONG = ["--set", "duration_s=200"]


class Running(NamedTuple):
    """A run in progress, with its handles."""

    process: subprocess.Popen[str]
    log: Path
    nodes: dict[str, int]
    """Process ids by name."""


@contextmanager
def running(folder: Path, *arguments: object) -> Iterator[Running]:
    """A long run past its first ticks; nothing of it is left afterwards."""
    log = folder / "run" / "bus.log"
    process = start("run", *arguments, *LONG, "--out", log.parent)
    nodes: dict[str, int] = {}
    try:
        wait_for(lambda: lines_of(log) > 500 or process.poll() is not None)
        nodes |= nodes_of(process)
        assert set(nodes) == {"plant", "controller"}
        yield Running(process, log, nodes)
    finally:
        for pid in nodes.values():
            if alive(pid):
                os.kill(pid, signal.SIGKILL)
        process.kill()
        process.communicate()


def lines_of(log: Path) -> int:
    return log.read_text().count("\n") if log.exists() else 0


def nodes_of(run: subprocess.Popen[str]) -> dict[str, int]:
    """Process ids of the nodes that the run has forked, by the names that they have."""
    found = {}
    for task in Path(f"/proc/{run.pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            name = Path(f"/proc/{child}/comm").read_text().strip()
            if name.startswith("rig-"):
                found[name.removeprefix("rig-")] = int(child)
    return found


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):  # of a process that ends meanwhile
        return False


def whole_ticks(log: Path) -> int:
    """Number of ticks on disk; each tick is complete and in order."""
    frames = list(can.LogReader(log))
    ticks = len(frames) // 5
    ids = [0x100, 0x101, 0x110, 0x111, 0x120]
    for at, frame in enumerate(frames[: 5 * ticks]):
        assert frame.arbitration_id == ids[at % 5]
        assert int.from_bytes(frame.data[2:4], "little") == (at // 5) & 0xFFFF
    return ticks


def summary_of(folder: Path, outcome: str) -> dict[str, Any]:
    """``run.json`` of a folder that is complete and ended with ``outcome``."""
    assert sorted(path.name for path in folder.iterdir()) == FILES
    summary: dict[str, Any] = json.loads((folder / "run.json").read_text())
    assert outcome in summary["outcome"]
    assert (folder / "report.png").read_bytes().startswith(b"\x89PNG")
    return summary


def folder_is_complete(folder: Path, outcome: str) -> dict[str, Any]:
    """The same of a lockstep run, with a row for every tick."""
    summary = summary_of(folder, outcome)
    ticks = whole_ticks(folder / "bus.log")
    rows = (folder / "signals.csv").read_text().splitlines()
    assert rows[0] == ",".join((HEADER, REPORTED, VERDICT, *EVIDENCE))
    assert len(rows) - 1 - ticks in (0, 1)  # a tick cut short has a row too
    assert [row.split(",")[0] for row in rows[1:4]] == ["0", "0.001", "0.002"]
    return summary


def one_line(text: str) -> str:
    """The error among what a run printed beside its progress."""
    assert "Traceback" not in text
    (line,) = [line for line in text.splitlines() if "error:" in line]
    return line
