"""Margins that are too thin: a loop that is stable, and hardly.

A peak |S| of 5 leaves a fifth of the distance between L and -1: a gain or a phase that is off by
some 20 % or 11° makes the loop unstable. A loop without a spare tick does not bear another latency.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from can_rig.scenario.settings import BudgetSettings
from firmware_model.analysis.margins import Margins


def thin_margins(budget: BudgetSettings, states: Iterable[tuple[str, Margins]]) -> Iterator[str]:
    """A part of a sentence for each margin of a stable state that is thinner than ``budget``."""
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
