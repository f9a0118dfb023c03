"""Runs a second of a campaign, beside two other ways to simulate the loop, in one go.

python-control and the numba loop get the loop without limits, frames, faults and decision: the
law is then a single matrix. Both write no file and compute no metric.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import control
import numpy as np
from rich.console import Console
from rich.table import Table

from can_rig.assessment.resolve import load
from can_rig.campaigns.execution import execute, open_folder
from can_rig.campaigns.plan import plan
from can_rig.campaigns.settings import read_campaign
from can_rig.campaigns.workers import in_processes
from can_rig.plant.frameless import frameless_loop
from can_rig.scenario.build import continuous_plant, controller_table, network_of
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_loop import linear_controller, sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.compiled import compiled
from firmware_model.law.structs import FloatArray

DURATION_S = 14.0
SLOW = ("tick_s=0.01", "design.tau_s=0.01", "design.tau_q_s=0.1")
"""The same at 100 Hz, with a design that such a tick allows."""


def campaign_rate(name: str, changes: tuple[str, ...], runs: int, workers: int) -> float:
    """Runs a second from the first block that is done on, table and metrics included."""
    settings = (f"duration_s={DURATION_S}", *changes)
    some = plan(read_campaign(name, settings, runs=runs))
    with tempfile.TemporaryDirectory() as folder:
        opened = open_folder(Path(folder) / "out", some, resume=False, force=False)
        done: list[tuple[float, int]] = []
        execute(
            opened,
            in_processes(some, workers),
            lambda: False,
            lambda so_far: done.append((time.perf_counter(), so_far)),
        )
        begin, before = done[0]
        return (runs - before) / (time.perf_counter() - begin)


def tick_ns(scenario: Scenario, repeats: int = 9) -> float:
    """Processor time of a tick of law and plant, the least of some runs."""
    times = []
    for _ in range(repeats):
        loop = frameless_loop(scenario, network_of(scenario))
        begin = time.process_time()
        loop.run()
        times.append(time.process_time() - begin)
    return min(times) / scenario.ticks * 1e9


def rate_of(run: Callable[[], object], least: int = 3) -> float:
    """Runs a second, by their median time; the first is not counted, which compiles."""
    run()
    times = []
    for _ in range(least):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return 1.0 / statistics.median(times)


def by_control(scenario: Scenario) -> Callable[[], object]:
    """The loop put together by ``interconnect`` and simulated by ``input_output_response``."""
    table, dt = controller_table(scenario, network_of(scenario)), scenario.tick_s
    law, car = linear_controller(table), sample(continuous_plant(scenario.plant), dt)
    blocks = [
        control.ss(law.a, law.b, law.c[:2], law.d[:2], dt, inputs=["y", "r"],
                   outputs=["u1", "u2"], name="law"),
        control.ss(np.zeros((2, 2)), np.eye(2), np.eye(2), np.zeros((2, 2)), dt,
                   inputs=["u1", "u2"], outputs=["v1", "v2"], name="bus"),
        control.ss(car.phi, car.gamma, car.c[None], np.zeros((1, 2)), dt, inputs=["v1", "v2"],
                   outputs=["y"], name="car"),
    ]  # fmt: skip
    loop = control.interconnect(blocks, inplist=["r"], outlist=["y", "u1", "u2"])
    time_s = np.arange(scenario.ticks) * dt
    reference = np.ones(scenario.ticks)
    return lambda: control.input_output_response(loop, time_s, reference)


def by_hand(scenario: Scenario) -> Callable[[], object]:
    """The same as one matrix in a loop that numba compiles."""
    table = controller_table(scenario, network_of(scenario))
    loop = sampled_loop(linear_controller(table), continuous_plant(scenario.plant), scenario.tick_s)
    a, b = loop.closed(), np.ascontiguousarray(loop.b[:, 1])
    return lambda: matrix_loop(a, b, loop.c, np.ones(scenario.ticks))


@compiled
def matrix_loop(a: FloatArray, b: FloatArray, c: FloatArray, reference: FloatArray) -> FloatArray:
    """y of x⁺ = Ax + br."""
    x, after, y = np.zeros(len(a)), np.zeros(len(a)), np.zeros(len(reference))
    for k in range(len(reference)):
        for i in range(len(a)):
            y[k] += c[i] * x[i]
            after[i] = b[i] * reference[k]
            for j in range(len(a)):
                after[i] += a[i, j] * x[j]
        x[:] = after
    return y


def bench_campaign(runs: int, workers: int) -> None:
    """Print the table."""
    scenario = load("default", [f"duration_s={DURATION_S}", "fault.kind=none"])
    table = Table(f"{DURATION_S:g} s of default", "runs/s", box=None)
    for name in ("hours", "losses"):
        for tick, changes in (("1 kHz", ()), ("100 Hz", SLOW)):
            campaign_rate(name, changes, 4 * workers, workers)
            rate = campaign_rate(name, changes, runs, workers)
            table.add_row(f"campaign {name}, {tick}, {workers} workers", f"{rate:.1f}")
    table.add_row("python-control, interconnect, 1 kHz", f"{rate_of(by_control(scenario)):.2f}")
    table.add_row("one matrix in a numba loop, 1 kHz", f"{rate_of(by_hand(scenario)):.1f}")
    console = Console()
    console.print(table)
    console.print(f"law and plant: {tick_ns(scenario):.0f} ns a tick", highlight=False)
