"""The loop beside a flood of random frames: no command changed, none lost unreported, memory flat.

A third process sends frames of random identifiers and random content, the rig's own identifiers
among them, as fast as it can. The log is compared, frame for frame, with that of an undisturbed run
in this process. Exit status: 0 all as it should be, 1 not.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
from rich.console import Console
from rich.table import Table

from can_rig.buses.bus import open_bus
from can_rig.controllers.our_law import PYTHON
from can_rig.nodes.bus_access import OnTick, StopRequest
from can_rig.nodes.processes import run_processes
from can_rig.nodes.runner import RunOptions, run_in_process
from can_rig.nodes.ticks import NodeSummary
from can_rig.scenario.loading import load

TAKEN_WITHIN_S = 10.0  # makes the local bus wait for the slowest listener
SETTLE_S = 2.0  # before the flood, and for what still waits after it
MEMORY_EVERY_S = 0.25
FLAT_KIB = 32_768  # growth of a node that still counts as flat


def flood(bus: str, frames: int) -> None:
    """Send ``frames`` random frames, as fast as the listeners take them, and read what comes."""
    rng = random.Random(1)
    with open_bus(bus) as sender:
        # A thread reads: senders keep every frame that a node does not read.
        listening = can.Notifier(sender, [], timeout=0.1)
        for _ in range(frames):
            sender.send(
                can.Message(
                    arbitration_id=rng.getrandbits(11),
                    is_extended_id=False,
                    data=rng.randbytes(rng.choice((0, 2, 8, 8, 8))),
                ),
                timeout=TAKEN_WITHIN_S,
            )
        listening.stop()


class Memory(threading.Thread):
    """Resident memory of the nodes, now and then, in KiB."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.samples: dict[str, list[int]] = {}
        self.over = threading.Event()

    def run(self) -> None:
        """Sample until ``over`` is set."""
        while not self.over.wait(MEMORY_EVERY_S):
            for name, resident in _nodes():
                self.samples.setdefault(name, []).append(resident)

    def growth(self, name: str) -> int:
        """From the beginning of the flood to the most that there ever was."""
        return max(self.samples[name]) - self.samples[name][0]


def _nodes() -> list[tuple[str, int]]:
    found = []
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    for child in children:
        name = Path(f"/proc/{child}/comm").read_text().strip()
        if name.startswith("rig-"):
            status = Path(f"/proc/{child}/status").read_text()
            resident = status.partition("VmRSS:")[2].split()
            if resident:  # a process that ends has none
                found.append((name.removeprefix("rig-"), int(resident[0])))
    return found


def run_beside_flood(bus: str, frames: int, log: Path, memory: Memory) -> tuple[NodeSummary, float]:
    """The loop from before the flood until after it; its summary, and the flood's seconds."""
    stop = StopRequest()
    started, seconds = threading.Event(), [0.0]

    def on_tick(ticks: int) -> None:
        if ticks > 0:
            started.set()

    def around_the_flood() -> None:
        started.wait()
        time.sleep(SETTLE_S)
        memory.start()
        begin = time.monotonic()
        spawn = multiprocessing.get_context("spawn")
        sender = spawn.Process(target=flood, args=(bus, frames))
        sender.start()
        sender.join()
        seconds[0] = time.monotonic() - begin
        time.sleep(SETTLE_S)
        stop.wanted = True

    flooding = threading.Thread(target=around_the_flood, daemon=True)

    @contextmanager
    def progress() -> Iterator[OnTick]:
        flooding.start()  # the nodes are forked by now
        yield on_tick

    scenario = load("thesis-step", ["duration_s=2000"])
    summary = run_processes(scenario, bus, log, stop, RunOptions(controller=PYTHON), progress)
    memory.over.set()
    return summary, seconds[0]


def disturbed(log: Path, undisturbed: Path) -> tuple[str | None, int]:
    """The difference in the rig's frames or None, and the number of foreign frames."""
    foreign = 0
    with log.open() as seen, undisturbed.open() as reference:
        expected = (line.split()[2:] for line in reference)
        awaited = next(expected, None)
        for line in seen:
            frame = line.split()[2:]
            if frame == awaited:
                awaited = next(expected, None)
            elif frame[1] == "T":
                return f"the plant sent {frame[0]} where {awaited} was right", foreign
            else:
                foreign += 1
    return (f"{awaited} is not in the log" if awaited else None), foreign


def main() -> int:
    """Flood, compare, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000, help="of the flood [1000000]")
    parser.add_argument("--bus", default=f"local:flood-{os.getpid()}", help="[a local one]")
    options = parser.parse_args()
    memory = Memory()
    with tempfile.TemporaryDirectory() as name:
        log, undisturbed = Path(name) / "flood.log", Path(name) / "quiet.log"
        summary, seconds = run_beside_flood(options.bus, options.frames, log, memory)
        quiet = load("thesis-step", [f"duration_s={summary.ticks / 1000}"])
        run_in_process(quiet, "virtual:quiet", undisturbed, StopRequest(), lambda _: None, PYTHON)
        difference, foreign = disturbed(log, undisturbed)
    lost = options.frames - foreign
    reported = summary.bus_events.get("plant", {}).get("frames dropped unread", 0)
    table = Table(box=None, show_header=False)
    table.add_row(
        "flood", f"{options.frames} frames in {seconds:.1f} s, {options.frames / seconds:.0f}/s"
    )
    table.add_row("ticks beside it", str(summary.ticks))
    table.add_row("commands and D*", difference or "as in the undisturbed run, frame for frame")
    table.add_row("flood in the log", f"{foreign}; {lost} not, {reported} of them reported")
    table.add_row("bus events", str(summary.bus_events or "none"))
    table.add_row("rejected by E2E", str(summary.rejected_frames))
    grown = {name: memory.growth(name) for name in memory.samples}
    for node, growth in grown.items():
        samples = memory.samples[node]
        table.add_row(
            f"memory of the {node}", f"{max(samples)} KiB at most, {growth} KiB more than at first"
        )
    Console(width=160).print(table)
    return int(difference is not None or lost > reported or max(grown.values()) > FLAT_KIB)


if __name__ == "__main__":
    sys.exit(main())
