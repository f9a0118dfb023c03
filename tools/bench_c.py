"""What the law costs in C and compiled by numba: a step alone, from Python, until the first one.

Processor time of this process, the least of many runs: another program cannot make it less.
"""

from __future__ import annotations

import ctypes
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, get_args

import numpy as np
from rich.console import Console
from rich.table import Table

from can_rig.assessment.resolve import load
from can_rig.controllers.compiled_law import CompiledLaw
from can_rig.export.compiler import shared_library
from can_rig.export.law import law_files
from can_rig.plant.frameless import controller_inputs
from can_rig.scenario.build import controller_table, network_of
from firmware_model.compiled import firmware_run
from firmware_model.firmware import PYTHON_LAW, Firmware, Law
from firmware_model.law import controller
from firmware_model.law.structs import Precision

LOOP = """
#include "controller.h"
#include "layout.h"
void loop(const struct layout_table *table, struct layout_state *state, const real *u, int32_t n);
void loop(const struct layout_table *table, struct layout_state *state, const real *u, int32_t n)
{
    for (int32_t k = 0; k < n; k++) {
        controller_step(table, state, u[2 * k], u[2 * k + 1]);
    }
}
"""
FIRST_STEP = """
from can_rig.assessment.resolve import load
from can_rig.controllers.making import controller_of
from can_rig.controllers.protocol import Inputs
from can_rig.scenario.build import network_of
scenario = load("default", [])
controller = controller_of({name!r}, scenario).start(scenario, network_of(scenario))
controller.step(Inputs(0.0, 0.0))
"""


@firmware_run
def numba_loop(tables: Any, states: Any, u: Any) -> None:
    """Every step of a run."""
    table, state = tables[0], states[0]
    for k in range(len(u)):
        controller.step(table, state, u[k, 0], u[k, 1])


def least_s(action: Callable[[], object], repeats: int) -> float:
    """Processor time of the fastest of so many."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return min(times)


def nanoseconds(precision: Precision) -> tuple[float, float]:
    """A step in a loop of C, and in a loop of numba."""
    scenario = load("default", [f'design.precision="{precision}"'])
    table = controller_table(scenario, network_of(scenario))
    tables = np.zeros(1, table.dtype)
    tables[0] = table
    u = np.ascontiguousarray(controller_inputs(scenario)[:65536], precision)
    at_rest = PYTHON_LAW.init(tables[0])
    states = at_rest.copy()
    library = ctypes.CDLL(str(shared_library(law_files(precision) | {"loop.c": LOOP})))
    memory = [ctypes.c_void_p(each.ctypes.data) for each in (tables, states, u)]

    def from_rest(loop: Callable[[], object]) -> Callable[[], object]:
        """Each run anew: on inputs that answer to no command states fade below normal numbers."""

        def run() -> None:
            states[:] = at_rest
            loop()

        return run

    in_c = least_s(from_rest(lambda: library.loop(*memory, ctypes.c_int32(len(u)))), 15)
    in_numba = least_s(from_rest(lambda: numba_loop(tables, states, u)), 15)
    return 1e9 * in_c / len(u), 1e9 * in_numba / len(u)


def microseconds(law: Law) -> tuple[float, float]:
    """A step from Python: of the law alone, and of ``Firmware.step``."""
    scenario = load("default", [])
    table = controller_table(scenario, network_of(scenario))
    firmware = Firmware(table, law)
    tables = np.zeros(1, table.dtype)
    tables[0] = table
    step = law.step_of(tables, law.init(tables[0]))

    def many(one: Callable[[float, float], object]) -> Callable[[], object]:
        return lambda: [one(0.1, 0.1) for _ in range(2000)]

    return least_s(many(step), 15) / 2e-3, least_s(many(firmware.step), 15) / 2e-3


def starting_s(name: str) -> float:
    """Processor time of a process until its first step, with everything in its caches."""
    times = []
    for _ in range(5):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-c", FIRST_STEP.format(name=name)], check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


def bench_c() -> None:
    """Measure, and print."""
    table = Table("of default", "C", "numba")
    for precision in get_args(Precision):
        found = nanoseconds(precision)
        table.add_row(f"ns a step, {precision}", *(f"{each:.0f}" for each in found))
    laws: tuple[Law, ...] = (CompiledLaw("float64"), PYTHON_LAW)
    alone, whole = zip(*map(microseconds, laws), strict=True)
    table.add_row("µs a step from Python", *(f"{each:.1f}" for each in alone))
    table.add_row("µs of Firmware.step", *(f"{each:.1f}" for each in whole))
    started = (starting_s("c"), starting_s("python"))
    table.add_row("s until the first step", *(f"{each:.2f}" for each in started))
    Console().print(table)
