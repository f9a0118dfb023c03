"""``can-rig figures``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from can_rig.thesis import figures
from can_rig.thesis.comparisons import compare


def figures_command(settings: Sequence[str], out: Path, force: bool) -> None:
    """Draw them, and say how far the firmware is from the continuous loop."""
    figures.refuse_existing(out, force)
    comparisons = compare(settings)
    table = Table(title="largest distance, sampled - continuous", box=None, pad_edge=False)
    for heading in ("figure", "signal", "whole run", "of its size", "after the loss", "tick"):
        table.add_column(heading, justify="left" if heading in {"figure", "signal"} else "right")
    for comparison in comparisons:
        tick = f"{comparison.scenario.tick_s * 1e3:g} ms"
        for curve in comparison.curves:
            distance, after = comparison.distance(curve), comparison.distance_after_loss(curve)
            table.add_row(
                comparison.figure,
                curve.name,
                f"{distance:.2e} {comparison.unit}".rstrip(),
                f"{distance / comparison.size:.1e}",
                "" if after is None else f"{after:.2e} {comparison.unit}".rstrip(),
                tick,
            )
    figures.draw_figures(out, comparisons, force)
    Console().print(table)
    Console().print(f"figures in {out}", highlight=False)
