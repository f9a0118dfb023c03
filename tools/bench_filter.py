"""A single filter: nanoseconds a sample beside scipy's, and how far it is from fifty digits."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import signal

from firmware_model import Filter, discretise
from tests.firmware.discretisation.random_filters import (
    random_filter,
    tustin_exactly,
    tustin_exactly_of_coefficients,
    zoh_exactly,
)

ORDERS = (1, 2, 4, 8, 12)
SAMPLES = 100_000
STEPS = 5_000
SHARES = np.array([1e-5, 1e-3, 0.03, 0.2, 0.6, 0.95])
"""Of the Nyquist frequency."""


def bench_filter(rounds: int, filters: int) -> None:
    """Print what a sample costs, then the errors of so many random filters."""
    console = Console()
    console.print(_costs(rounds))
    console.print(_errors(filters))


def _costs(rounds: int) -> Table:
    """Medians over rounds in which everything is measured in turn."""
    u = np.random.default_rng(1).standard_normal(SAMPLES)
    table = Table("order", "run, ns a sample", "scipy's sosfilt", "a step, µs", box=None)
    for order in ORDERS:
        system = signal.ZerosPolesGain(*signal.butter(order, 100.0, analog=True, output="zpk"))
        made = discretise(system, 1e-3)
        sos = made.to_scipy_sos()
        made.run(u)  # compiles
        measured: dict[str, Callable[[], object]] = {
            "run": lambda made=made: made.run(u),  # type: ignore[misc]
            "sosfilt": lambda sos=sos: signal.sosfilt(sos, u),  # type: ignore[misc]
            "step": lambda made=made: _steps(made),  # type: ignore[misc]
        }
        times_s: dict[str, list[float]] = {name: [] for name in measured}
        for _ in range(rounds):
            for name, call in measured.items():
                begin = time.perf_counter()
                call()
                times_s[name].append(time.perf_counter() - begin)
        median_s = {name: statistics.median(some) for name, some in times_s.items()}
        table.add_row(
            f"{order}",
            f"{1e9 * median_s['run'] / SAMPLES:.1f}",
            f"{1e9 * median_s['sosfilt'] / SAMPLES:.1f}",
            f"{1e6 * median_s['step'] / STEPS:.1f}",
        )
    return table


def _steps(made: Filter) -> None:
    for _ in range(STEPS):
        made.step(1.0)


def _errors(filters: int) -> Table:
    """Relative to the response, for zoh to the largest; the worst frequency of each filter."""
    rng = np.random.default_rng(0)
    errors: dict[str, list[float]] = {
        "tustin, from roots": [],
        "tustin, from coefficients": [],
        "zoh, of the largest response": [],
    }
    of_roots, of_coefficients, of_zoh = errors.values()
    for _ in range(filters):
        g, tick_s = random_filter(rng)
        omega = SHARES * math.pi / tick_s
        num, den = g.numerator(), g.denominator()
        exact = tustin_exactly(g, omega, tick_s)
        of_roots.append(_worst(discretise(g, tick_s).frequency_response(omega), exact))
        exact = tustin_exactly_of_coefficients(num, den, omega, tick_s)
        answer = discretise((num, den), tick_s).frequency_response(omega)
        of_coefficients.append(_worst(answer, exact))
        g, tick_s = random_filter(rng)
        omega = SHARES * math.pi / tick_s
        exact = zoh_exactly(g, omega, tick_s)
        error = np.abs(discretise(g, tick_s, "zoh").frequency_response(omega) - exact)
        of_zoh.append(float(error.max() / np.abs(exact).max()))
    table = Table(f"error of {filters} random filters", "median", "worst", box=None)
    for name, some in errors.items():
        table.add_row(name, f"{statistics.median(some):.1e}", f"{max(some):.1e}")
    return table


def _worst(answer: np.ndarray, exact: np.ndarray) -> float:
    return float(np.abs(answer / exact - 1.0).max())
