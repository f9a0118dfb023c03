"""Rates of the lockstep loop, of a log decoded (bench_decode.py), of a filter.

Interleaved, so that a noisy machine disturbs all alike; medians.
"""

from __future__ import annotations

import argparse
import itertools
import os
import statistics
import tempfile
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
from rich.console import Console
from rich.table import Table

from can_rig.buses.bus import open_for_node
from can_rig.buses.local.bus import LocalBus
from can_rig.controllers.our_law import PYTHON
from can_rig.frames.codec import MessageCodec, Receiver
from can_rig.frames.network import Network
from can_rig.nodes.bursts import Bursts
from can_rig.nodes.bus_access import SYSTEM_CLOCK, PersistentSender, StopRequest
from can_rig.nodes.processes import run_processes
from can_rig.nodes.recording import CandumpLines, Recorder
from can_rig.nodes.runner import RunOptions, run_in_process
from can_rig.plant.frameless import frameless_loop, inputs_of, law_of
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware

Codecs = tuple[MessageCodec, ...]

ALONE = ["design.supervision=none", "design.compensation=always"]
MULTICAST = "udp_multicast:239.74.163.2"


def ignore(_ticks: int) -> None:
    """Progress that nobody watches."""


def new_log(folder: Path) -> Path:
    """A log of its own for each run."""
    return folder / f"{uuid.uuid4().hex}.log"


def in_process(scenario: Scenario, folder: Path) -> float:
    """Ticks a second of both nodes in this process."""
    bus = f"local:bench-{uuid.uuid4().hex[:8]}"
    summary = run_in_process(scenario, bus, new_log(folder), StopRequest(), ignore, PYTHON)
    return summary.ticks / summary.wall_s


def two_processes(scenario: Scenario, bus: str, folder: Path) -> float:
    """Ticks a second of two processes on ``bus``."""
    summary = run_processes(
        scenario, bus, new_log(folder), StopRequest(), RunOptions(controller=PYTHON)
    )
    return summary.ticks / summary.wall_s


def microseconds(action: Callable[[], object], repeats: int = 9, number: int = 2000) -> float:
    """Median of ``repeats`` timings of ``number`` calls, per call."""
    timings = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(number):
            action()
        timings.append((time.perf_counter() - start) / number * 1e6)
    return statistics.median(timings)


def parts(scenario: Scenario, network: Network, folder: Path) -> list[tuple[str, float]]:
    """Name and µs a tick of each part, in one process."""
    firmware = Firmware(controller_table(scenario, network))
    simulated = SimulatedPlant(scenario)
    name = f"local:bench-{uuid.uuid4().hex[:8]}"
    offers = (network.reference, network.feedback)
    answers = (network.command_1, network.command_2, network.status)
    with (
        open_for_node(name, (), False) as plant_bus,
        open_for_node(name, (), False) as controller_bus,
        Recorder(folder / "parts.log") as recorder,
    ):
        plant = bursts(plant_bus, offers, answers, recorder)
        controller = bursts(controller_bus, answers, offers, None)
        exchange(plant, controller, recorder, 0)
        ticks = itertools.count(1)
        return [
            (
                "frames: 5 packed, protected, sent, received, checked, read, put on disk",
                microseconds(lambda: exchange(plant, controller, recorder, next(ticks))),
            ),
            ("step: the control law", microseconds(lambda: firmware.step(1.0, 0.5))),
            ("plant: measured and advanced", microseconds(lambda: step_plant(simulated))),
        ]


def without_frames(*settings: str) -> float:
    """Median processor time of a tick of ``default`` in compiled code, µs."""
    scenario = load("default", ["duration_s=30", *settings])
    network = network_of(scenario)
    of, inputs = law_of(scenario, network), inputs_of(scenario, network)
    loops = [frameless_loop(scenario, network, of, inputs) for _ in range(7)]
    timings = []
    for loop in loops:
        start = time.thread_time()
        loop.run()
        timings.append((time.thread_time() - start) * 1e6 / scenario.ticks)
    return statistics.median(timings)


def bursts(
    bus: can.BusABC, own: Codecs, others: Codecs, lines: CandumpLines | None
) -> tuple[Bursts, list[Receiver], can.BusABC]:
    """One node's access to its frames, with the slow way for the first tick."""
    assert isinstance(bus, LocalBus)
    receivers = [Receiver(codec) for codec in others]
    sender = PersistentSender(bus, 1.0, SYSTEM_CLOCK)
    return Bursts(bus, sender, own, receivers, lines), receivers, bus


def exchange(plant: Any, controller: Any, recorder: Recorder, tick: int) -> None:
    """The frames of a tick both ways, and their lines in the log."""
    recorder.flush()
    recorder.at(tick * 1_000_000)
    for (sender, *_), (reader, receivers, bus) in ((plant, controller), (controller, plant)):
        sender.send(tick, (1.0, 2.0, 3.0))
        if reader.receive(tick) is None:
            for receiver in receivers:
                receiver.accept(bus.recv(1.0))


def step_plant(simulated: SimulatedPlant) -> None:
    """One tick of the plant."""
    simulated.measure()
    simulated.advance(0, 1.0, 1.0)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    kinds = ("loop", "decode", "filter")
    parser.add_argument("what", nargs="?", choices=kinds, default="loop")
    parser.add_argument("--rounds", type=int, default=3, help="interleaved rounds [3]")
    parser.add_argument("--seconds", type=float, default=5.0, help="loop: simulated time a run [5]")
    parser.add_argument(
        "--frames", type=int, default=100_000, help="decode: length of the log [100000]"
    )
    parser.add_argument(
        "--dbc", type=Path, help="decode: random frames of this database [the rig's]"
    )
    parser.add_argument("--filters", type=int, default=1000, help="filter: random ones [1000]")
    options = parser.parse_args()
    if options.what == "decode":
        from bench_decode import bench_decode  # noqa: PLC0415 (asammdf is slow to import)

        bench_decode(options.frames, options.rounds, options.dbc)
    elif options.what == "filter":
        from bench_filter import bench_filter  # noqa: PLC0415 (as above)

        bench_filter(options.rounds, options.filters)
    else:
        bench_loop(options.rounds, options.seconds)


def bench_loop(rounds: int, seconds: float) -> None:
    """Print the two tables of the loop."""
    scenario = load("thesis-step", [f"duration_s={seconds}"])
    network = network_of(scenario)
    console = Console()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runs: dict[str, Callable[[], float]] = {
            "one process, local": lambda: in_process(scenario, folder),
            "two processes, local": lambda: two_processes(
                scenario, f"local:bench-{os.getpid()}", folder
            ),
            "two processes, udp_multicast": lambda: two_processes(scenario, MULTICAST, folder),
        }
        rates: dict[str, list[float]] = {label: [] for label in runs}
        for _ in range(rounds):
            for label, measure in runs.items():
                rates[label].append(measure())
        table = Table("nodes and bus", "ticks/s", "x real time at 1 kHz", "µs a tick", box=None)
        for label, values in rates.items():
            rate = statistics.median(values)
            table.add_row(label, f"{rate:.0f}", f"{rate / 1000:.1f}", f"{1e6 / rate:.1f}")
        console.print(table)
        ratio = statistics.median(
            a / b
            for a, b in zip(
                rates["two processes, local"], rates["two processes, udp_multicast"], strict=True
            )
        )
        console.print(f"local over udp_multicast: {ratio:.1f} times the rate\n", highlight=False)
        table = Table("part of a tick, in one process", "µs", box=None)
        for label, cost in parts(scenario, network, folder):
            table.add_row(label, f"{cost:.1f}")
        console.print(table)
        table = Table("\ndefault without frames: law, actuators, plant, sensor", "\nµs", box=None)
        for label, settings in (("as shipped", []), ("the thesis's law alone", ALONE)):
            table.add_row(label, f"{without_frames(*settings):.2f}")
        console.print(table)


if __name__ == "__main__":
    main()
