"""A single filter: nanoseconds a sample beside scipy's, and how far it is from fifty digits."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import signal

from firmware_model import Filter, discretise, testing
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.rules import Rule
from firmware_model.discretisation.sections import realisation
from firmware_model.errors import DesignError
from tests.firmware.discretisation.random_filters import random_filter, tustin_exactly, zoh_exactly

ORDERS = (1, 2, 4, 8, 12)
SAMPLES = 100_000
STEPS = 5_000
SHARES = np.array([1e-5, 1e-3, 0.03, 0.2, 0.6, 0.95])
"""Of the Nyquist frequency."""


def bench_filter(rounds: int, filters: int) -> None:
    """Print what a sample costs, the errors of so many random filters, and mutants caught."""
    console = Console()
    console.print(_costs(rounds))
    console.print(_errors(filters))
    console.print(_caught(min(filters, 300), 200))


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
        coefficients = (g.numerator(), g.denominator())
        exact = tustin_exactly(g, omega, tick_s)
        of_roots.append(_worst(discretise(g, tick_s).frequency_response(omega), exact))
        exact = tustin_exactly(coefficients, omega, tick_s)
        answer = discretise(coefficients, tick_s).frequency_response(omega)
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


Arrays = list[np.ndarray]


def _caught(filters: int, mutants: int) -> Table:
    """Filters from coefficients, and how many mutants of each kind ``assert_follows`` sees.

    A mutant has a single coefficient changed, or its tick or rule is not the one that is meant.
    """
    rng, outcomes = np.random.default_rng(7), dict[str, list[bool]]()
    for number in range(filters):
        g, tick_s = random_filter(rng, held=True)
        rules: list[Rule] = ["tustin", "zoh"]
        rule = rules[number % 2]
        way, make = _way_in(number // 2, g, tick_s)

        def seen(arrays: Arrays, make: _Make = make, g: ZeroPoleGain = g, **meant: Any) -> bool:
            try:
                testing.assert_follows(make(arrays), g, **meant)
            except (AssertionError, DesignError):
                return True
            return False

        meant: dict[str, Any] = {"tick_s": tick_s, "rule": rule}
        outcomes.setdefault("none: the filter itself", []).append(seen(way(rule, tick_s), **meant))
        for factor in (0.1, 0.5, 2.0, 10.0):
            off = seen(way(rule, factor * tick_s), **meant)
            outcomes.setdefault("coefficients for another tick", []).append(off)
            off = seen(way(rule, tick_s), tick_s=factor * tick_s, rule=rule)
            outcomes.setdefault("stated for another tick", []).append(off)
        other: Rule = rules[1 - number % 2]
        outcomes.setdefault("the other rule", []).append(seen(way(other, tick_s), **meant))
        for _ in range(mutants):
            arrays = [array.copy() for array in way(rule, tick_s)]
            places = [(i, j) for i, array in enumerate(arrays) for j in _free(array)]
            i, j = places[rng.integers(len(places))]
            if rng.random() < 0.1:
                kind, factor = "a sign", -1.0
            else:
                decade = int(rng.integers(-9, -1))
                kind = f"a coefficient by 1e{decade} to 1e{decade + 1}"
                factor = 1.0 + rng.choice([-1.0, 1.0]) * 10 ** (decade + rng.random())
            arrays[i].flat[j] *= factor
            outcomes.setdefault(kind, []).append(seen(arrays, **meant))
    table = Table(f"changed in {filters} filters", "mutants", "caught", box=None)
    for kind, some in sorted(outcomes.items()):
        table.add_row(kind, f"{len(some)}", f"{100 * np.mean(some):.2f} %")
    return table


_Make = Callable[[Arrays], Filter]
_Way = Callable[[Rule, float], Arrays]


def _way_in(number: int, g: ZeroPoleGain, tick_s: float) -> tuple[_Way, _Make]:
    """Coefficients of ``g`` in one of the forms, by rule and tick, and the filter of them."""

    def sos(rule: Rule, at_s: float) -> Arrays:
        return [discretise(g, at_s, rule).to_scipy_sos()]

    def cmsis(rule: Rule, at_s: float) -> Arrays:
        (rows,) = sos(rule, at_s)
        return [np.column_stack([rows[:, :3], -rows[:, 4:]])]

    def ba(rule: Rule, at_s: float) -> Arrays:
        (rows,) = sos(rule, at_s)  # sos2tf drops the leading zero of a zero-order hold
        return [reduce(np.convolve, half) for half in (rows[:, :3], rows[:, 3:])]

    def matrices(rule: Rule, at_s: float) -> Arrays:
        a, b, c, d, _ = realisation(discretise(g, at_s, rule).sections)
        return [a, b[:, None], c[None], np.array([[d]])]

    ways: list[tuple[_Way, _Make]] = [
        (sos, lambda arrays: Filter.from_sos(*arrays, tick_s=tick_s)),
        (cmsis, lambda arrays: Filter.from_cmsis(*arrays, tick_s=tick_s)),
        (cmsis, lambda arrays: Filter.from_cmsis(*arrays, tick_s=tick_s, precision="float64")),
        (matrices, lambda arrays: Filter.from_state_space(*arrays, tick_s=tick_s)),
        (ba, lambda arrays: Filter.from_ba(*arrays, tick_s=tick_s)),
    ]
    return ways[number % (5 if g.order <= 3 else 4)]


def _free(array: np.ndarray) -> np.ndarray:
    """Places of the numbers that a filter may choose: neither 0 nor 1."""
    return np.flatnonzero((array != 0.0) & (array != 1.0))
