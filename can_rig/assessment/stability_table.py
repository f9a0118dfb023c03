"""A loop's margins as a table, the thin margins in words, and figures for JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

from can_rig.scenario.settings import BudgetSettings
from firmware_model.analysis.margins import Margins

ALWAYS: Final[dict[str, Callable[[Margins], str]]] = {
    "spectral radius": lambda m: f"{m.spectral_radius:.5f}",
    "slowest, rad/s": lambda m: f"{m.slowest_rad_per_s:.4g}",
    "its damping": lambda m: f"{m.slowest_damping:.3f}",
}
"""Figures of any loop."""

IF_STABLE: Final[dict[str, Callable[[Margins], str]]] = {
    "delay, ticks": lambda m: _or_any(m.delay_margin_ticks),
    "delay, ms": lambda m: _or_any(m.delay_margin_s, 1e3),
    "gain margin": lambda m: f"{m.gain_margin:.4g}",
    "peak |S|": lambda m: f"{m.peak_sensitivity:.3f}",
    "u1 / noise": lambda m: f"{m.noise_to_command_1:.3g}",
    "u2 / noise": lambda m: f"{m.noise_to_command_2:.3g}",
}
"""Margins, and the rms of each command for white measurement noise of rms 1."""


def table_rows(states: Iterable[tuple[str, Margins]]) -> Iterator[tuple[str, ...]]:
    """A heading with the names of the states, then a row for each figure.

    "-" stands for the missing figures of an unstable loop, "any" for an unlimited margin.
    """
    named = list(states)
    yield "", *(name for name, _ in named)
    for label, form in ALWAYS.items():
        yield label, *(form(margins) for _, margins in named)
    for label, form in IF_STABLE.items():
        yield label, *(form(margins) if margins.stable else "-" for _, margins in named)


def thin_margins(budget: BudgetSettings, states: Iterable[tuple[str, Margins]]) -> Iterator[str]:
    """A part of a sentence for each margin of a stable state below ``budget``.

    With a peak |S| of 5, L keeps a fifth of the distance to -1: a gain error of 20 %, or a phase
    error of 11°, can make the loop unstable.
    """
    for name, figures in states:
        if not figures.stable:
            continue
        peak, spare = figures.peak_sensitivity, figures.delay_margin_ticks
        if peak > budget.peak_sensitivity:
            yield (
                f"{name}: the peak |S| is {peak:.4g} and must be at most "
                f"{budget.peak_sensitivity:g} (budget.peak_sensitivity)"
            )
        if spare is not None and spare < budget.spare_ticks:
            yield (
                f"{name}: the spare ticks of delay are {spare} and must be at least "
                f"{budget.spare_ticks} (budget.spare_ticks)"
            )


def finite_or_null(value: Any) -> Any:
    """``value`` with None in place of every infinite number or nan."""
    if isinstance(value, dict):
        return {key: finite_or_null(inner) for key, inner in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _or_any(value: float | None, scale: float = 1.0) -> str:
    return "any" if value is None else f"{scale * value:.4g}"
