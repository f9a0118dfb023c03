"""Axis scales that show lasting values and tolerate single outliers."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from can_rig.drawing.names import printed
from firmware_model.target.structs import FloatArray

FAR: Final = 3.0
"""Curves that reach this many times further than the panel do not set its scale."""


def include_zero(axis: Axes, values: FloatArray) -> None:
    """Let the axis begin or end at zero at least."""
    if np.isfinite(values).any():
        axis.update_datalim([(axis.dataLim.x0, 0.0)])
        axis.autoscale_view()


def reach_for(axis: Axes, values: FloatArray) -> None:
    """Widen the limits for ``values``, except for remote values."""
    low, high = axis.get_ylim()
    finite, span = values[np.isfinite(values)], high - low
    if len(finite) and np.ptp(finite) <= FAR * span:
        room = 0.05 * span
        axis.set_ylim(min(low, finite.min() - room), max(high, finite.max() + room))
    else:
        axis.set_ylim(low, high)


def clip_spikes(axis: Axes, time_s: FloatArray, values: FloatArray, unit: str) -> None:
    """Write a spike of a few samples on the axis instead of letting it set the scale."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return
    include_zero(axis, values)
    largest = float(np.abs(finite).max())
    if largest == 0.0:
        axis.set_ylim(-1.0, 1.0)
        return
    low, high = min(0.0, np.quantile(finite, 0.005)), max(0.0, np.quantile(finite, 0.995))
    span = high - low
    if largest <= FAR * span or span == 0.0:
        return
    axis.set_ylim(low - 0.25 * span, high + 0.25 * span)
    at = int(np.nanargmax(np.abs(values)))
    spike = f"{values[at]:.3g} {printed(unit)}".rstrip()
    axis.text(
        0.0, 1.03, f"off the scale: {spike} at {time_s[at]:g} s",
        transform=axis.transAxes, fontsize=9,
    )  # fmt: skip


def logarithmic(axis: Axes, size: FloatArray, floor: float) -> None:
    """Decades from ``floor`` to above 1 and the largest of ``size``."""
    axis.set_yscale("log")
    largest = float(np.nanmax(size)) if np.isfinite(size).any() else 1.0
    axis.set_ylim(0.7 * floor, max(1.0, 3.0 * largest))
    axis.yaxis.set_major_locator(LogLocator(100.0, numticks=12))
    axis.yaxis.set_minor_locator(LogLocator(10.0, numticks=24))
    axis.yaxis.set_minor_formatter(NullFormatter())
