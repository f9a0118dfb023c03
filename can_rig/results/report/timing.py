"""The panel of ``report.png`` that only a real-time run has: how late it was."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from can_rig.drawing.style import BLUE, DASHED, INK, ORANGE, legend_above


def draw_timing(axis: Axes, tick_s: float, realtime: dict[str, Any]) -> None:
    """Two histograms side by side over logarithmic bins of time, and the tick that limits both.

    Args:
        axis: the panel.
        tick_s: the tick.
        realtime: as ``Timing.as_dict`` has it.
    """
    for key, label, color, shift in (
        ("wake_up_lateness_us", "wake-up lateness", BLUE, -0.2),
        ("answer_after_us", "answer after", ORANGE, 0.2),
    ):
        counts, edges = realtime[key]["counts"], realtime[key]["edges_us"]
        axis.bar(np.arange(len(counts)) + shift, counts, 0.4, color=color, label=label)
    axis.set_yscale("symlog", linthresh=1.0)
    axis.set_ylim(bottom=0.0)
    axis.set_xticks(np.arange(len(edges)) - 0.5, [f"{edge:g}" for edge in edges])
    at = float(np.interp(tick_s * 1e6, edges, np.arange(len(edges)))) - 0.5
    axis.axvline(at, color=INK, lw=0.8, ls=DASHED, label="one tick")
    axis.set_xlabel("time in µs, lower edge of the bin")
    axis.set_ylabel("ticks")
    axis.grid(axis="y", alpha=0.3, lw=0.5)
    legend_above(axis)
