"""Curves of fewer points, without losing a peak."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from can_rig.storage import paged
from firmware_model.law.structs import FloatArray

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


BUCKET_S: Final = 0.016
"""Of which two rows remain: 2,500 for 20 s, more than a screen has columns, 60 times a second."""


class Decimator:
    """Reduces every ``bucket`` rows to two: minimum and maximum of each column, in order of time.

    Args:
        bucket: number of rows, 1 or above; 1 keeps every row.
        columns: number of columns of a row; the first column is the time.
    """

    def __init__(self, bucket: int, columns: int) -> None:
        self._bucket = bucket
        self._waiting: FloatArray = np.empty((0, columns))

    def take(self, rows: FloatArray) -> FloatArray:
        """The reduced rows (m, columns) of the buckets that ``rows`` (n, columns) complete.

        Rows of an incomplete bucket wait for the next call.
        """
        if self._bucket == 1:
            return rows
        waiting = np.concatenate([self._waiting, rows])
        whole = len(waiting) // self._bucket
        split = whole * self._bucket
        self._waiting = waiting[split:]
        return extremes(waiting[:split].reshape(whole, self._bucket, waiting.shape[1]))


def extremes(buckets: FloatArray) -> FloatArray:
    """Minimum and maximum of each bucket, (2 * buckets, columns), in the order of their rows.

    ``buckets`` is (buckets, rows, columns) with at least two rows. The times (column 0) are the
    times of the first row and of the middle row. A column with nan in a whole bucket stays nan.
    """
    count, rows, columns = buckets.shape
    least = np.where(np.isnan(buckets), np.inf, buckets)
    greatest = np.where(np.isnan(buckets), -np.inf, buckets)
    first, second = least.min(axis=1), greatest.max(axis=1)
    rising = least.argmin(axis=1) <= greatest.argmax(axis=1)
    pairs = np.stack([np.where(rising, first, second), np.where(rising, second, first)], axis=1)
    pairs[~np.isfinite(pairs)] = np.nan
    pairs[:, 0, 0], pairs[:, 1, 0] = buckets[:, 0, 0], buckets[:, rows // 2, 0]
    return pairs.reshape(2 * count, columns)
