"""Fewer rows for the screen, without losing a peak."""

from __future__ import annotations

from typing import Final

import numpy as np

from firmware_model.target.structs import FloatArray

BUCKET_S: Final = 0.02
"""Of which two rows remain: 2,000 for 20 s, as many as a screen has columns."""


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
