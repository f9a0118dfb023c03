"""The load of each bus over the time of a log, and its frames a second."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from can_rig.drawing import style
from can_rig.views.log_statistics import LogStatistics


def load_page(statistics: LogStatistics) -> Figure:
    """A panel for each bus: the upper bound of its busy share in each second."""
    buses = statistics.buses
    figure = style.page(0.8 + 1.6 * max(len(buses), 1))
    grid = figure.subplots(max(len(buses), 1), 1, sharex=True, squeeze=False)
    for (axis,), bus in zip(grid, buses, strict=False):
        second, share = statistics.load(bus)
        edges = np.stack([second, second, second + 1, second + 1], axis=1).ravel()
        begins = np.diff(second, prepend=-np.inf) > 1  # no frame in the second before
        ends = np.diff(second, append=np.inf) > 1
        first, last = np.where(begins, 0.0, share), np.where(ends, 0.0, share)
        heights = np.stack([first, share, share, last], axis=1).ravel()
        axis.plot(edges, 100 * heights, color=style.BLUE, lw=1.2)
        axis.set_ylabel(style.labelled(f"load of {bus}", "%"))
        axis.set_ylim(bottom=0.0)
        style.ruled(axis)
    grid[-1][0].set_xlabel("time since the first frame in s")
    return figure
