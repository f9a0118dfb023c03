"""Fewer rows for the screen, without losing a peak."""

from __future__ import annotations

from typing import Final

import numpy as np

from firmware_model.target.structs import FloatArray

BUCKET_S: Final = 0.02
"""Of which two rows remain: 2,000 for 20 s, as many as a screen has columns."""


class Decimator:
    """Two rows of every ``bucket`` rows: least and greatest of each column, in their order.

    Args:
        bucket: how many rows, 1 or above; 1 leaves everything as it is.
        columns: how many columns a row has; the first is the time.
    """

    def __init__(self, bucket: int, columns: int) -> None:
        self._bucket = bucket
        self._waiting: FloatArray = np.empty((0, columns))

    def take(self, rows: FloatArray) -> FloatArray:
        """What ``rows`` (n, columns) complete, (m, columns); the rest waits for the next call."""
        if self._bucket == 1:
            return rows
        waiting = np.concatenate([self._waiting, rows])
        whole = len(waiting) // self._bucket
        split = whole * self._bucket
        self._waiting = waiting[split:]
        return extremes(waiting[:split].reshape(whole, self._bucket, waiting.shape[1]))


def extremes(buckets: FloatArray) -> FloatArray:
    """Least and greatest of each bucket, (2 * buckets, columns), in the order of their rows.

    ``buckets`` is (buckets, rows, columns), two rows at least. The time (column 0) is that of the
    first row, and that of the row in the middle. A column that is nan in a whole bucket stays nan.
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
