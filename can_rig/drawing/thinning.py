"""A curve of fewer points, without losing a peak."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from can_rig import paged
from firmware_model.target.structs import FloatArray

MAX_POINTS: Final = 20_000
"""A longer curve is cut into half as many slices, and the extremes of each are drawn."""


def thinned(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A curve of at most ``MAX_POINTS`` points of the given one, among them every peak."""
    if len(values) <= MAX_POINTS:
        return time_s, values
    size = -(-2 * len(values) // MAX_POINTS)
    step = size * max(1, paged.BLOCK_ROWS // size)
    times, extremes = [], []
    for begin in range(0, len(values), step):
        block = values[begin : begin + step]
        chosen = _extremes(block, size)
        times.append(time_s[begin + chosen])
        extremes.append(block[chosen])
        paged.let_go()
    return np.concatenate(times), np.concatenate(extremes)


def _extremes(values: FloatArray, size: int) -> NDArray[np.intp]:
    """Where the least and the greatest of each ``size`` values are, in their order."""
    known = np.isfinite(values)
    rest = -len(values) % size
    least, greatest = (
        np.pad(np.where(known, values, end), (0, rest), constant_values=end).reshape(-1, size)
        for end in (np.inf, -np.inf)
    )
    begins = np.arange(0, len(values), size)
    both: NDArray[np.intp] = np.unique(
        np.concatenate([begins + least.argmin(axis=1), begins + greatest.argmax(axis=1)])
    )
    return both
